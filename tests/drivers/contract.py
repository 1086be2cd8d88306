"""The contract of every dual-stream sensor, checked on sensors that are not open yet.

A driver's tests call `check_sensor` with a function that makes one; its pictures must differ from
frame to frame, and it must have at least ten of them.
"""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import DTypeLike, NDArray

from drivers.sensor import DualStreamSensor, Exposure
from pipeline.errors import PoolExhausted
from pipeline.messages import Geometry, Header, RoiSchedule

Make = Callable[[], DualStreamSensor]


def memory(_output: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Grant every loan."""
    return np.empty(shape, dtype)


def refuse(_output: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Refuse every loan."""
    raise PoolExhausted(f"no room for {shape} of {dtype}")


def started(sensor: DualStreamSensor, *, realtime: bool = False) -> DualStreamSensor:
    sensor.open(realtime=realtime)
    sensor.start()
    return sensor


def read(sensor: DualStreamSensor) -> Exposure:
    exposure = sensor.read(memory)
    assert exposure is not None
    return exposure


def command(
    stream: str, *, made_from: int, first: int, windows: list[tuple[int, int, int, int]]
) -> RoiSchedule:
    header = Header(stream=stream, seq=made_from, stamp_ns=0)
    return RoiSchedule(header=header, first_seq=first, windows=np.array(windows, np.int32))


def answers_to_a_stop(sensor: DualStreamSensor) -> list[Exposure | None]:
    """Stop a sensor while another thread waits in `read`; return what that read returned."""
    answers: list[Exposure | None] = []
    reader = threading.Thread(target=lambda: answers.append(sensor.read(memory)))
    reader.start()
    sensor.stop()
    reader.join(30)
    sensor.close()
    return answers


def check_sensor(make: Make) -> None:
    """Check the whole contract."""
    check_frames_say_what_they_show(make)
    check_each_opening_is_a_new_stream(make)
    check_commands_shape_the_frames_they_name(make)
    check_windows_of_any_kind_become_windows_of_the_roi(make)
    check_late_and_foreign_commands_are_counted(make)
    check_an_exposure_without_memory_is_spent(make)
    check_pictures_lie_in_the_memory_lent(make)
    check_closing_is_safe_after_any_outcome(make)


def check_frames_say_what_they_show(make: Make) -> None:
    sensor = started(make())
    can = sensor.capabilities()
    try:
        first, second = read(sensor), read(sensor)
    finally:
        sensor.close()
    grid = can.geometry
    assert second.header.seq == first.header.seq + 1
    assert second.header.stamp_ns > first.header.stamp_ns
    assert first.header.geometry == grid
    assert first.context.header == first.roi.header == first.header
    assert first.context.window == (0, 0, grid.width_px, grid.height_px)
    assert first.context.size_px == can.context_px
    assert_addressable(first.roi.window, grid)
    assert not np.array_equal(first.context.pixels, second.context.pixels)


def check_each_opening_is_a_new_stream(make: Make) -> None:
    streams = set()
    for _ in range(2):
        sensor = started(make())
        streams.add(read(sensor).header.stream)
        sensor.close()
    assert len(streams) == 2


def check_commands_shape_the_frames_they_name(make: Make) -> None:
    sensor = started(make())
    can = sensor.capabilities()
    grid = can.geometry
    try:
        seen = read(sensor).header
        first = seen.seq + can.lead_frames
        wanted = (0, 0, grid.roi_width_px, grid.roi_height_px)
        sensor.set_rois(command(seen.stream, made_from=seen.seq, first=first, windows=[wanted]))
        frames = {e.header.seq: e.roi for e in (read(sensor) for _ in range(can.lead_frames + 1))}
    finally:
        sensor.close()
    assert frames[first].window == wanted
    assert (frames[first].command_seq, frames[first].status) == (seen.seq, "ok")
    held = frames[first + 1]
    assert (held.window, held.command_seq, held.status) == (wanted, -1, "unplanned")


def check_windows_of_any_kind_become_windows_of_the_roi(make: Make) -> None:
    for window in [(-500, -500, -400, -400), (7, 5, 8, 9), (10**6, 3, 10**6 + 1, 4), (9, 9, 1, 1)]:
        sensor = started(make())
        can = sensor.capabilities()
        seen = read(sensor).header
        windows = [window] * (can.lead_frames + 1)
        sensor.set_rois(
            command(seen.stream, made_from=seen.seq, first=seen.seq + 1, windows=windows)
        )
        last = [read(sensor) for _ in windows][-1]
        sensor.close()
        assert last.roi.command_seq == seen.seq
        assert_addressable(last.roi.window, can.geometry)


def check_late_and_foreign_commands_are_counted(make: Make) -> None:
    sensor = started(make())
    window = (0, 0, 4, 4)
    seen = [read(sensor) for _ in range(3)][-1].header
    sensor.set_rois(command(seen.stream, made_from=seen.seq - 1, first=seen.seq, windows=[window]))
    sensor.set_rois(command("another", made_from=0, first=0, windows=[window] * 99))
    sensor.set_rois(command(seen.stream, made_from=seen.seq, first=0, windows=[window] * 99))
    counted = sensor.summary()["commands"]
    sensor.close()
    assert counted == {"accepted": 1, "late": 1, "foreign": 1}


def check_an_exposure_without_memory_is_spent(make: Make) -> None:
    sensor = started(make())
    first = read(sensor)
    with pytest.raises(PoolExhausted):
        sensor.read(refuse)
    third = read(sensor)
    sensor.close()
    assert third.header.seq == first.header.seq + 2


def check_pictures_lie_in_the_memory_lent(make: Make) -> None:
    lent: dict[str, NDArray[Any]] = {}

    def loan(output: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        lent[output] = np.empty(shape, dtype)
        return lent[output]

    sensor = started(make())
    exposure = sensor.read(loan)
    sensor.close()
    assert exposure is not None
    assert exposure.context.pixels is lent["context"]
    assert exposure.roi.pixels is lent["roi"]


def check_closing_is_safe_after_any_outcome(make: Make) -> None:
    sensor = make()
    sensor.close()
    sensor.open(realtime=False)
    sensor.close()
    started(sensor)
    sensor.stop()
    assert sensor.read(memory) is None
    sensor.close()
    sensor.close()


def assert_addressable(window: tuple[int, int, int, int], grid: Geometry) -> None:
    left, top, right, bottom = window
    assert (right - left, bottom - top) == (grid.roi_width_px, grid.roi_height_px)
    assert 0 <= left <= right <= grid.width_px
    assert 0 <= top <= bottom <= grid.height_px
    assert left % grid.step_px == 0
    assert top % grid.step_px == 0
