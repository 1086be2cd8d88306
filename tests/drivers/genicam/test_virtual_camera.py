"""Streaming from a virtual GigE camera with every failure, over the loopback."""

import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

from drivers.genicam import GenicamCamera
from drivers.sensor import Mode
from pipeline.errors import DriverError
from pipeline.pixel_formats import FORMATS
from tests.drivers.contract import answers_to_a_stop, check_sensor, command, read, started
from tests.drivers.genicam.streaming import (
    ROOT,
    VIRTUAL,
    camera,
    needs_aravis,
    next_picture,
    sensor,
    streaming,
)
from tests.drivers.genicam.virtual_camera import (
    STORED,
    Nature,
    VirtualCamera,
    describe,
    loopback,
    scene,
    twelve_bits,
)
from tests.drivers.packing import numbers

pytestmark = needs_aravis()


@pytest.fixture(scope="module", autouse=True)
def port() -> Iterator[None]:
    """The port of GigE cameras cannot be chosen: one test process at a time."""
    with loopback():
        yield


def test_the_newest_frame_wins_and_those_between_are_counted() -> None:
    with VirtualCamera() as virtual, streaming(camera(VIRTUAL)) as made:
        next_picture(made)
        seen = virtual.frames
        while virtual.frames < seen + 30:
            time.sleep(0.005)
        newest = next_picture(made)
        behind = virtual.frames - int(newest.pixels[0, 0])

    assert newest.skipped >= 20
    assert behind <= 5


def test_a_picture_is_a_view_of_the_camera_memory_and_outlives_the_camera() -> None:
    with VirtualCamera() as virtual:
        with streaming(camera(VIRTUAL)) as made:
            kept = next_picture(made).pixels
        expected = scene(virtual.nature.sensor_px)

    assert not kept.flags.owndata
    assert np.array_equal(kept.ravel()[1:], expected.ravel()[1:])


@pytest.mark.parametrize("pixel_format", ["Mono12p", "Mono12Packed"])
def test_a_plain_camera_unpacks_its_samples(pixel_format: str) -> None:
    with VirtualCamera(Nature(pixel_format=pixel_format)) as virtual:
        made = camera(VIRTUAL)
        told = made.open()
        shown = next_picture(made).pixels.copy()
        made.close()
        expected = twelve_bits(scene(virtual.nature.sensor_px))

    assert (told.pixel_format, told.transport) == ("grey12", f"GigE Vision, {pixel_format}")
    assert np.array_equal(shown.ravel()[1:], expected.ravel()[1:])


@pytest.mark.parametrize(
    ("pixel_format", "ours"), [("Mono12p", "grey12p"), ("Mono12Packed", "grey12")]
)
def test_a_sensor_sends_packed_samples_on_and_unpacks_the_older_ones(
    pixel_format: str, ours: str
) -> None:
    nature = Nature(pixel_format=pixel_format)
    whole = twelve_bits(scene(nature.sensor_px))
    with VirtualCamera(nature):
        made = started(sensor(binning=4))
        can = made.capabilities()
        taken = [read(made) for _ in range(3)]
        made.close()

    assert can.pixel_formats == (ours,)
    form = FORMATS[ours]
    for exposure in taken:
        left, top, right, bottom = exposure.roi.window
        assert (exposure.roi.pixel_format, exposure.roi.size_px) == (ours, (64, 32))
        assert (exposure.roi.pixels.shape, exposure.roi.pixels.dtype) == (
            form.shape((64, 32)), form.dtype,
        )  # fmt: skip
        for frame, truth in (
            (exposure.roi, whole[top:bottom, left:right]),
            (exposure.context, whole[::4, ::4]),
        ):
            assert np.array_equal(numbers(frame.pixels, form).ravel()[1:], truth.ravel()[1:])


def test_frames_that_lack_a_packet_are_counted_and_not_delivered() -> None:
    with VirtualCamera(Nature(lost=list(range(3, 200, 2)))) as virtual:
        with streaming(camera(VIRTUAL)) as made:
            numbers = [int(next_picture(made).pixels[0, 0]) for _ in range(10)]
        counted = made.summary()["frames"]

    assert all(number not in virtual.nature.lost for number in numbers)
    assert counted["incomplete"] >= 5


def test_a_camera_in_use_is_refused_in_a_sentence() -> None:
    with VirtualCamera(), streaming(camera(VIRTUAL)):
        other = subprocess.run(
            [sys.executable, "-c", "from tests.drivers.genicam.streaming import *\n"
             "try: camera(VIRTUAL).open()\nexcept Exception as error: print(error)"],
            cwd=ROOT, capture_output=True, text=True, timeout=60, check=True,
        )  # fmt: skip

    assert other.stdout == f"{VIRTUAL}: expected a free camera, got one in use by another host\n"


def read_on(made: GenicamCamera) -> None:
    while made.read(60) is not None:
        pass


@pytest.mark.slow  # the library takes seconds to give up a camera
def test_a_camera_that_stays_away_is_an_error() -> None:
    made = camera(VIRTUAL, absent_s=0.5)
    with VirtualCamera():
        made.open()
        next_picture(made)
    with pytest.raises(DriverError, match=r"camera \S+: expected it back within 0.5 s, got: "):
        read_on(made)
    made.close()


@pytest.mark.parametrize(
    "nature",
    [Nature(latency_frames=1), Nature(locked=STORED, sets=40)],
    ids=["writes, a frame late", "sequencer"],
)
def test_a_camera_that_is_aimed_keeps_the_contract_of_a_sensor(nature: Nature) -> None:
    with VirtualCamera(nature):
        check_sensor(sensor)


@pytest.mark.parametrize("latency", [0, 1, 4])
def test_context_and_roi_show_what_their_windows_say(latency: int) -> None:
    nature = Nature(latency_frames=latency)
    whole = scene(nature.sensor_px)
    with VirtualCamera(nature):
        made = started(sensor(binning=4))
        can = made.capabilities()
        stream = read(made).header.stream
        windows = [(8 * k, 4 * k, 8 * k + 64, 4 * k + 32) for k in range(20)]
        made.set_rois(command(stream, made_from=0, first=0, windows=windows))
        taken = [read(made) for _ in range(12)]
        figures = made.summary()
        made.close()

    assert figures["latency_frames"] == latency
    assert can.lead_frames == 1 + latency // 2
    assert not can.same_exposure
    for exposure in taken:
        x, y, right, bottom = exposure.roi.window
        assert np.array_equal(exposure.roi.pixels.ravel()[1:], whole[y:bottom, x:right].ravel()[1:])
        assert np.array_equal(exposure.context.pixels.ravel()[1:], whole[::4, ::4].ravel()[1:])
        assert exposure.context.delay_ns == 0
        assert exposure.roi.delay_ns > 0
    for exposure in taken[can.lead_frames :]:
        assert exposure.roi.window == windows[exposure.header.seq]
        assert (exposure.roi.command_seq, exposure.roi.status) == (0, "ok")


def test_windows_of_a_sequencer_lie_on_the_grid_that_its_sets_allow() -> None:
    nature = Nature(locked=STORED, sets=40)
    whole = scene(nature.sensor_px)
    with VirtualCamera(nature) as virtual:
        made = started(sensor(binning=4))
        grid = made.capabilities().geometry
        stream = read(made).header.stream
        step = grid.step_px
        windows = [(step * k, step, step * k + 64, step + 32) for k in range(4)]
        made.set_rois(command(stream, made_from=0, first=1, windows=windows))
        taken = [read(made).roi for _ in windows]
        made.close()

    columns, rows = (256 - 64) // step + 1, (128 - 32) // step + 1
    assert columns * rows < 40 <= ((192 // (step - 4)) + 1) * ((96 // (step - 4)) + 1)
    assert [roi.window for roi in taken] == windows
    assert all(
        np.array_equal(roi.pixels[1:], whole[y:bottom, x:right][1:])
        for roi, (x, y, right, bottom) in zip(taken, windows, strict=True)
    )
    assert virtual.denied == 0


@pytest.mark.parametrize(
    ("nature", "reason"),
    [
        (Nature(locked=("OffsetX",)), "cannot foveate: offset cannot move while it streams"),
        (Nature(locked=STORED[2:]), "cannot foveate: the full field cannot be seen between two"),
        (Nature(follows=False), "expected offset (192, 96) within 8 frames, got (0, 0)"),
        (Nature(states_offsets=False), "expected offset (192, 96) within 8 frames, got (0, 0)"),
        (Nature(wide_when_binned=True), "its payload is not constant, it cannot foveate"),
    ],
    ids=["locked offset", "locked binning", "ignored offset", "untold offset", "payload"],
)
def test_a_camera_that_cannot_foveate_is_refused_with_the_reason(
    nature: Nature, reason: str
) -> None:
    with VirtualCamera(nature), pytest.raises(DriverError) as caught:
        sensor().open(realtime=True)

    assert reason in str(caught.value)
    if "cannot foveate: " in reason:
        assert "run it as a plain camera: sensor: drivers.cameras:CameraSensor" in str(caught.value)


def test_locks_that_the_description_hides_are_refused_by_the_camera() -> None:
    honest = Nature(locked=("OffsetX",))
    with (
        VirtualCamera(Nature(locked=("OffsetX",), xml=describe(Nature()))) as virtual,
        pytest.raises(DriverError, match=r"OffsetX: 192 is refused: .*access.denied"),
    ):
        sensor().open(realtime=True)

    assert virtual.denied >= 1
    assert honest.locked == virtual.nature.locked


def test_a_frame_that_lacks_a_packet_is_taken_again() -> None:
    with VirtualCamera(Nature(lost=[10, 11, 14])):
        made = started(sensor(answer_s=0.5))
        numbers = [read(made).header.seq for _ in range(8)]
        figures = made.summary()
        made.close()

    assert numbers == list(range(8))
    assert figures["frames"]["incomplete"] == 3
    assert figures["losses"] == 0


def test_a_sensor_that_dies_comes_back_with_the_next_exposure() -> None:
    with VirtualCamera() as first:
        made = started(sensor(answer_s=0.2, absent_s=60))
        before = [read(made) for _ in range(3)][-1].header
        first.close()
    with VirtualCamera():
        after = read(made).header
        figures = made.summary()
        made.close()

    assert after.stream == before.stream
    assert after.seq > before.seq
    assert figures["losses"] == 1


@pytest.mark.slow
def test_stop_ends_a_read_that_waits_for_a_lost_camera() -> None:
    with VirtualCamera():
        made = started(sensor(answer_s=0.2))
        read(made)

    assert answers_to_a_stop(made) == [None]


def test_in_real_time_the_rate_is_kept_and_late_exposures_are_left_out() -> None:
    with VirtualCamera():
        made = started(sensor(rate_hz=20), realtime=True)
        steady = [read(made).header for _ in range(4)]
        time.sleep(0.3)
        late = read(made).header
        figures = made.summary()
        made.close()

    assert late.seq - steady[-1].seq >= 5
    assert figures["frames"]["late"] >= 4
    elapsed_s = (late.stamp_ns - steady[0].stamp_ns) / 1e9
    assert elapsed_s == pytest.approx((late.seq - steady[0].seq) / 20, abs=0.2)


def test_a_mode_chooses_the_size_of_the_roi_and_others_are_refused() -> None:
    with VirtualCamera():
        made = sensor()
        made.open(realtime=False)
        made.configure(Mode(roi_px=(128, 64)))
        made.start()
        shown = read(made)
        for mode in (Mode(roi_px=(1, 1)), Mode(pixel_format="rgb8"), Mode(rate_hz=1e6)):
            with pytest.raises(ValueError, match="expected"):
                made.configure(mode)
        made.close()

    assert shown.roi.pixels.shape == shown.context.pixels.shape == (64, 128)
    assert shown.header.geometry.roi_width_px == 128
