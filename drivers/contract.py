"""The contract of every dual-stream sensor, checked on sensors that are not open yet.

`check_sensor(make)` is for the tests of a driver; `fovea sensors test` runs the same checks on a
device. `make` returns a new sensor each time. Its pictures must differ from frame to frame, and it
must have at least ten of them.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from drivers.commands import Window
from drivers.sensor import FURTHER, DualStreamSensor, Exposure
from pipeline.errors import DriverError, PoolExhausted
from pipeline.messages import Geometry, Header, RoiSchedule

Make = Callable[[], DualStreamSensor]
Figures = Mapping[str, Any]  # what a check measured, by name
Check = Callable[[Make], Figures]
ODD_WINDOWS = ((-500, -500, -400, -400), (7, 5, 8, 9), (10**6, 3, 10**6 + 1, 4), (9, 9, 1, 1))
SKIPPED = "skipped"  # key of figures: why a check does not apply


class ContractBroken(DriverError):
    """A sensor does not keep the contract; the text says what was expected and what it did."""


def memory(
    _output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
) -> NDArray[Any]:
    """Grant every loan."""
    return np.empty(shape, dtype)


def refuse(
    _output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
) -> NDArray[Any]:
    """Refuse every loan."""
    raise PoolExhausted(f"no room for {shape} of {dtype}")


@contextmanager
def running(make: Make, *, realtime: bool = False) -> Iterator[DualStreamSensor]:
    """Open and start a sensor; close it after any outcome."""
    sensor = make()
    try:
        sensor.open(realtime=realtime)
        sensor.start()
        yield sensor
    finally:
        sensor.close()


def read(sensor: DualStreamSensor) -> Exposure:
    """Return the next exposure; raises `ContractBroken` at the end of the stream."""
    exposure = sensor.read(memory)
    if exposure is None:
        raise ContractBroken("read: expected an exposure, got the end of the stream")
    return exposure


def command(
    stream: str, *, made_from: int, first: int, windows: Sequence[Window | Sequence[Window]]
) -> RoiSchedule:
    """Return a command for the frames from `first` on, one window or a list of them for each."""
    header = Header(stream=stream, seq=made_from, stamp_ns=0)
    return RoiSchedule(header=header, first_seq=first, windows=np.array(windows, np.int32))


def check_sensor(make: Make) -> None:
    """Check the whole contract; raises `ContractBroken` at the first thing that is not kept."""
    for check in CHECKS:
        check(make)


def check_frames_say_what_they_show(make: Make) -> Figures:
    """Headers follow one another, windows are those of the grid, pictures are new ones."""
    with running(make) as sensor:
        can = sensor.capabilities()
        first, second = read(sensor), read(sensor)
    grid = can.geometry
    _expect("seq of the second frame", second.header.seq, first.header.seq + 1)
    if second.header.stamp_ns <= first.header.stamp_ns:
        raise ContractBroken(
            f"stamps: expected the second after {first.header.stamp_ns}, got "
            f"{second.header.stamp_ns}"
        )
    _expect("geometry of the header", first.header.geometry, grid)
    _expect("header of the context", first.context.header, first.header)
    _expect("header of the ROI", first.roi.header, first.header)
    _expect("window of the context", first.context.window, (0, 0, grid.width_px, grid.height_px))
    _expect("size of the context", first.context.size_px, can.context_px)
    check_addressable(first.roi.window, grid)
    if np.array_equal(first.context.pixels, second.context.pixels):
        raise ContractBroken(
            "context: expected pictures that differ, got two equal ones (is it dark there?)"
        )
    return {"field_px": (grid.width_px, grid.height_px), "context_px": can.context_px}


def check_each_opening_is_a_new_stream(make: Make) -> Figures:
    """Frames of two openings cannot be taken for one another."""
    streams = []
    for _ in range(2):
        with running(make) as sensor:
            streams.append(read(sensor).header.stream)
    if streams[0] == streams[1]:
        raise ContractBroken(f"stream: expected another one after it was opened, got {streams[0]}")
    return {}


def check_commands_shape_the_frames_they_name(make: Make) -> Figures:
    """A command in time is obeyed by its frames, and says so in them; then the window is held."""
    with running(make) as sensor:
        can = sensor.capabilities()
        if not can.roi_sizes_px:
            return {SKIPPED: "it reads no region"}
        grid = can.geometry
        seen = read(sensor).header
        first = seen.seq + can.lead_frames
        wanted = (0, 0, grid.roi_width_px, grid.roi_height_px)
        sensor.set_rois(command(seen.stream, made_from=seen.seq, first=first, windows=[wanted]))
        frames = {e.header.seq: e.roi for e in (read(sensor) for _ in range(can.lead_frames + 1))}
    for seq, named in ((first, (wanted, seen.seq, "ok")), (first + 1, (wanted, -1, "unplanned"))):
        if seq not in frames:
            raise ContractBroken(f"frames: expected number {seq}, got {sorted(frames)}")
        roi = frames[seq]
        what = f"window, command and status {seq - first} after the first commanded frame"
        _expect(what, (roi.window, roi.command_seq, roi.status), named)
    return {"lead_frames": can.lead_frames}


def check_windows_of_any_kind_become_windows_of_the_roi(make: Make) -> Figures:
    """Windows outside, too small or inside out are clamped and aligned, never refused."""
    for window in ODD_WINDOWS:
        with running(make) as sensor:
            can = sensor.capabilities()
            if not can.roi_sizes_px:
                return {SKIPPED: "it reads no region"}
            seen = read(sensor).header
            windows = [window] * (can.lead_frames + 1)
            sensor.set_rois(
                command(seen.stream, made_from=seen.seq, first=seen.seq + 1, windows=windows)
            )
            last = [read(sensor) for _ in windows][-1]
        _expect(f"command of the frame for {window}", last.roi.command_seq, seen.seq)
        check_addressable(last.roi.window, can.geometry)
    return {"windows": len(ODD_WINDOWS)}


def check_several_windows_are_read_together_or_refused(make: Make) -> Figures:
    """Each window of a frame is a frame of the same exposure; more than it reads are an error."""
    with running(make) as sensor:
        can = sensor.capabilities()
        if not can.roi_sizes_px:
            return {SKIPPED: "it reads no region"}
        grid, seen = can.geometry, read(sensor).header
        apart = [grid.aligned(k * (grid.width_px - grid.roi_width_px) // 4) for k in range(5)]
        row = [(x, 0, x + grid.roi_width_px, grid.roi_height_px) for x in apart]
        try:
            sensor.set_rois(_rows(seen, [row[: can.rois + 1]]))
        except DriverError:
            pass
        else:
            raise ContractBroken(
                f"set_rois: expected an error for {can.rois + 1} windows in one frame, of which "
                f"it reads {can.rois}, got none"
            )
        sensor.set_rois(_rows(seen, [row[: can.rois]] * can.lead_frames))
        last = [read(sensor) for _ in range(can.lead_frames)][-1]
    frames = (last.roi, *last.further)
    _expect("windows of one exposure", [frame.window for frame in frames], row[: can.rois])
    for frame in frames:
        _expect("header of a window", frame.header, last.header)
        _expect("command of a window", frame.command_seq, seen.seq)
    return {"rois": can.rois}


def _rows(seen: Header, rows: list[list[Window]]) -> RoiSchedule:
    return command(seen.stream, made_from=seen.seq, first=seen.seq + 1, windows=rows)


def check_late_and_foreign_commands_are_counted(make: Make) -> Figures:
    """A command for a frame that is over, or of another stream, is counted and not used."""
    with running(make) as sensor:
        window = (0, 0, 4, 4)
        seen = [read(sensor) for _ in range(3)][-1].header
        for stream, made_from, first, windows in (
            (seen.stream, seen.seq - 1, seen.seq, [window]),
            ("another", 0, 0, [window] * 99),
            (seen.stream, seen.seq, 0, [window] * 99),
        ):
            sensor.set_rois(command(stream, made_from=made_from, first=first, windows=windows))
        counted = dict(sensor.summary()["commands"])
    _expect("commands", counted, {"accepted": 1, "late": 1, "foreign": 1})
    return counted


def check_an_exposure_without_memory_is_spent(make: Make) -> Figures:
    """Where no memory is granted the exposure is lost, and the next one has the next number."""
    with running(make) as sensor:
        first = read(sensor)
        try:
            sensor.read(refuse)
        except PoolExhausted:
            pass
        else:
            raise ContractBroken("read: expected PoolExhausted from the loan, got an exposure")
        third = read(sensor)
    _expect("seq after a lost exposure", third.header.seq, first.header.seq + 2)
    return {}


def check_pictures_lie_in_the_memory_lent(make: Make) -> Figures:
    """Nothing is copied between the sensor's memory and the frame pool."""
    lent: dict[str, list[NDArray[Any]]] = defaultdict(list)

    def loan(
        output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        lent[output].append(np.empty(shape, dtype))
        return lent[output][-1]

    with running(make) as sensor:
        exposure = sensor.read(loan)
    if exposure is None:
        raise ContractBroken("read: expected an exposure, got the end of the stream")
    outputs = {"context": exposure.context, "roi": exposure.roi}
    outputs |= dict(zip(FURTHER, exposure.further, strict=False))
    for output, frame in outputs.items():
        pixels = frame.pixels
        if pixels.size and not any(pixels is memory for memory in lent[output]):
            raise ContractBroken(f"{output}: expected the memory that was lent, got other memory")
    return {"bytes": sum(each[0].nbytes for each in lent.values() if each)}


def check_closing_is_safe_after_any_outcome(make: Make) -> Figures:
    """`close` may come before `open`, before `start`, after `stop`, and twice."""
    sensor = make()
    sensor.close()
    sensor.open(realtime=False)
    sensor.close()
    with running(lambda: sensor):
        sensor.stop()
        if sensor.read(memory) is not None:
            raise ContractBroken("read after stop: expected None, got an exposure")
        sensor.close()
    return {}


CHECKS: tuple[Check, ...] = (
    check_frames_say_what_they_show,
    check_each_opening_is_a_new_stream,
    check_commands_shape_the_frames_they_name,
    check_windows_of_any_kind_become_windows_of_the_roi,
    check_several_windows_are_read_together_or_refused,
    check_late_and_foreign_commands_are_counted,
    check_an_exposure_without_memory_is_spent,
    check_pictures_lie_in_the_memory_lent,
    check_closing_is_safe_after_any_outcome,
)


def title(check: Check) -> str:
    """Return what a check says of the sensor.

    >>> title(check_frames_say_what_they_show)
    'frames say what they show'
    """
    return check.__name__.removeprefix("check_").replace("_", " ")


def check_addressable(window: Window, grid: Geometry) -> None:
    """Raise `ContractBroken` unless a window has the ROI's size and lies on the grid."""
    left, top, right, bottom = window
    size, wanted = (right - left, bottom - top), (grid.roi_width_px, grid.roi_height_px)
    _expect("size of the ROI's window", size, wanted)
    inside = left >= 0 and right <= grid.width_px and top >= 0 and bottom <= grid.height_px
    if not inside or left % grid.step_px or top % grid.step_px:
        raise ContractBroken(
            f"window of the ROI: expected one within {grid.width_px}x{grid.height_px} at multiples "
            f"of {grid.step_px}, got {window}"
        )


def _expect(what: str, got: object, wanted: object) -> None:
    if got != wanted:
        raise ContractBroken(f"{what}: expected {wanted}, got {got}")
