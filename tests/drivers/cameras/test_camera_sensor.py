"""A plain camera as a dual-stream sensor: the contract, what is cut, how time is told."""

import threading
import time
from typing import Any

import numpy as np
import pytest

from drivers.camera import Picture
from drivers.cameras import CameraSensor, CameraSensorSettings
from drivers.cameras.cutting import FORMATS
from drivers.sensor import Mode
from operators.capture import CaptureSettings
from pipeline.errors import DriverError, PoolExhausted, SettingsError
from pipeline.settings import build
from tests.drivers.cameras.synthetic_camera import SyntheticCamera
from tests.drivers.contract import (
    answers_to_a_stop,
    check_sensor,
    command,
    memory,
    read,
    refuse,
    started,
)
from tests.drivers.numbered import number_of, picture

CAMERA = "tests.drivers.cameras.synthetic_camera:SyntheticCamera"


def sensor(camera_options: dict[str, Any] | None = None, **settings: Any) -> CameraSensor:
    values: dict[str, Any] = {"camera": CAMERA, "camera_options": camera_options or {}}
    return CameraSensor(build(CameraSensorSettings, values | settings, "options"))


@pytest.mark.parametrize("pixel_format", FORMATS)
def test_it_keeps_the_contract_of_a_sensor_in_every_format(pixel_format: str) -> None:
    check_sensor(lambda: sensor({"pixel_format": pixel_format}))

    assert SyntheticCamera.opened == 0


@pytest.mark.parametrize(
    "settings", [{"step_px": 16}, {"roi_scale": 0.5}, {"rate_hz": 25}, {"roi_area": 1.0}]
)
def test_it_keeps_the_contract_of_a_sensor_with_any_settings(settings: dict[str, Any]) -> None:
    check_sensor(lambda: sensor(**settings))


class Absent(SyntheticCamera):
    """It sends one frame and is then lost, and looked for, for half a second."""

    lost_s = 0.0

    def read(self, timeout_s: float) -> Picture | None:
        found = super().read(timeout_s)
        self.lost_s = self.lost_s or time.monotonic()
        return found

    @property
    def absent_until_s(self) -> float:
        return self.lost_s + 0.5 if self.lost_s else 0.0


def test_a_lost_camera_has_its_own_limit_and_then_that_of_a_frame() -> None:
    subject = started(
        sensor({"frames": 1}, camera=f"{__name__}:Absent", read_timeout_s=0.2), realtime=True
    )
    assert subject.absent_until_s == 0.0
    read(subject)
    told_s = subject.absent_until_s
    with pytest.raises(DriverError, match=r"expected a frame within 0\.2 s, got none"):
        read(subject)
    ended_s = time.monotonic()
    subject.close()

    assert ended_s >= told_s + 0.2


def test_context_and_roi_are_cut_from_the_same_frame() -> None:
    subject = started(sensor())
    read(subject)
    shown = read(subject)
    subject.close()

    whole = picture(1)
    left, top, right, bottom = shown.roi.window
    assert np.array_equal(shown.roi.pixels, whole[top:bottom, left:right])
    assert shown.context.pixels.shape == (48, 80, 3)
    assert number_of(shown.context.pixels, scale=0.25) == 1
    assert shown.roi.window == (120, 72, 200, 120)


def test_frames_that_the_camera_skipped_are_gaps_that_the_summary_counts() -> None:
    subject = sensor({"skipped": 2, "rate_hz": 30})
    subject.open(realtime=True)
    subject.start()
    seqs = [read(subject).header.seq for _ in range(4)]
    subject.close()

    figures = subject.summary()
    assert seqs == [0, 3, 6, 9]
    assert figures["frames"] == {
        "exposed": 4, "skipped": 6, "late": 6, "overrun": 0, "elapsed": 10,
    }  # fmt: skip
    assert figures["rate"] == {"asked_hz": 30.0, "achieved_hz": 12.0}
    assert figures["camera"] == {"made": 4}
    assert figures["headline"] == (
        "320x192 from tests.drivers.cameras.synthetic_camera:SyntheticCamera (memory), "
        "6 of 10 frames missed"
    )


def test_a_lower_rate_takes_the_newest_frame_when_it_is_due() -> None:
    subject = sensor(rate_hz=20)
    subject.open(realtime=True)
    subject.start()
    begun_s = time.monotonic()
    headers = [read(subject).header for _ in range(4)]
    lasted_s = time.monotonic() - begun_s
    subject.close()

    assert lasted_s >= 0.15
    passed = [(h.stamp_ns - headers[0].stamp_ns) * 20 / 1e9 for h in headers]
    assert [h.seq for h in headers] == [int(exposures + 1e-6) for exposures in passed]
    assert subject.summary()["rate"]["asked_hz"] == 20.0


def test_an_exposure_without_memory_is_counted_as_an_overrun() -> None:
    subject = started(sensor())
    read(subject)
    with pytest.raises(PoolExhausted):
        subject.read(refuse)
    subject.close()

    frames = subject.summary()["frames"]
    assert (frames["exposed"], frames["overrun"], frames["elapsed"]) == (1, 1, 2)


def test_stop_ends_a_read_that_waits_in_another_thread() -> None:
    subject = started(sensor({"frames": 1}))
    read(subject)

    assert answers_to_a_stop(subject) == [None]


def test_stop_ends_a_read_that_waits_for_its_time() -> None:
    subject = sensor(rate_hz=0.1)
    subject.open(realtime=True)
    subject.start()
    read(subject)

    assert answers_to_a_stop(subject) == [None]


def test_the_camera_stays_open_while_a_frame_of_it_is_cut() -> None:
    subject = started(sensor())
    inside, closing = threading.Event(), threading.Event()

    def loan(output: str, shape: tuple[int, ...], dtype: Any) -> Any:
        inside.set()
        assert closing.wait(30)
        assert SyntheticCamera.opened == 1
        return memory(output, shape, dtype)

    reader = threading.Thread(target=lambda: subject.read(loan))
    reader.start()
    assert inside.wait(30)
    closer = threading.Thread(target=subject.close)
    closer.start()
    closing.set()
    reader.join(30)
    closer.join(30)

    assert SyntheticCamera.opened == 0


def test_a_silent_camera_is_an_error_in_time() -> None:
    subject = started(sensor({"frames": 1}, read_timeout_s=0.2))
    read(subject)
    with pytest.raises(DriverError, match=r"expected a frame within 0\.2 s, got none"):
        subject.read(memory)
    subject.close()


def test_frames_that_change_their_size_are_an_error() -> None:
    subject = started(sensor({"grows_at": 2}))
    read(subject), read(subject)
    with pytest.raises(DriverError, match="expected rgb8 of 320x192 as at the start, got uint8"):
        subject.read(memory)
    subject.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"unreachable": True}, "it is not there"),
        ({"pixel_format": "yuyv8"}, "pixels: expected rgb8"),
        ({"size_px": [0, 0]}, "expected sides of 1 to 32768 px, got 0x0"),
        ({"pixel_format": "bayer_rggb8", "size_px": [321, 192]}, "a mosaic needs even sides"),
    ],
)
def test_a_camera_that_cannot_be_used_is_closed_again(options: dict[str, Any], said: str) -> None:
    with pytest.raises(DriverError, match=said):
        sensor(options).open(realtime=True)

    assert SyntheticCamera.opened == 0


def test_a_mosaic_needs_an_even_step() -> None:
    with pytest.raises(SettingsError, match="step_px: a mosaic needs an even step, got 3"):
        sensor({"pixel_format": "bayer_rggb8"}, step_px=3).open(realtime=True)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"camera": ""}, "camera: expected an import path module:Class, got ''"),
        ({"camera": "math:pi"}, "camera: expected a Camera, got math:pi"),
        ({"camera_options": {"size": 3}}, "options.camera_options.size: no such setting"),
        ({"context_scale": 0}, "context_scale: expected above 0 to 1, got 0"),
        ({"roi_area": 1.5}, "roi_area: expected above 0 to 1, got 1.5"),
        ({"step_px": -1}, "step_px: expected 0 to 32768, got -1"),
        ({"rate_hz": 0.01}, "rate_hz: expected 0.1 to 1000 or 0, got 0.01"),
        ({"read_timeout_s": 0}, "read_timeout_s: expected 0.1 to 3600, got 0"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError) as error:
        sensor(**settings)

    assert said in str(error.value)


def test_a_mode_changes_the_rate_and_nothing_else() -> None:
    subject = sensor()
    subject.open(realtime=True)
    subject.configure(Mode(rate_hz=12))
    subject.start()
    read(subject), read(subject)
    for mode in (Mode(roi_px=(1, 1)), Mode(pixel_format="bayer_rggb8"), Mode(rate_hz=9999)):
        with pytest.raises(SettingsError):
            subject.configure(mode)
    subject.close()

    assert subject.summary()["rate"]["asked_hz"] == 12.0


def test_what_is_not_open_says_so() -> None:
    subject = sensor()
    for act in (
        subject.capabilities,
        subject.start,
        lambda: subject.read(memory),
        lambda: subject.set_rois(command("s", made_from=0, first=1, windows=[(0, 0, 1, 1)])),
    ):
        with pytest.raises(DriverError):
            act()


def test_a_picture_outlives_neither_its_camera_nor_the_next_one() -> None:
    """The contract lends a picture: the sensor must have cut it before it asks again."""

    class Reusing(SyntheticCamera):
        def read(self, timeout_s: float) -> Picture | None:
            found = super().read(timeout_s)
            if found is None:
                return None
            if self.made == 1:
                self.lent = found.pixels
            np.copyto(self.lent, found.pixels)
            return Picture(pixels=self.lent, stamp_ns=found.stamp_ns)

    subject = sensor()
    subject._camera = Reusing(SyntheticCamera.settings_type())
    started(subject)
    exposures = [read(subject) for _ in range(3)]
    subject.close()

    assert [number_of(e.context.pixels, scale=0.25) for e in exposures] == [0, 1, 2]


def test_a_graph_names_camera_and_sensor() -> None:
    settings = CaptureSettings(
        sensor="drivers.cameras:CameraSensor",
        options={"camera": "drivers.cameras:Webcam", "camera_options": {"device": 3}},
    )

    assert (settings.shows, settings.source) == ("", "/dev/video3")
