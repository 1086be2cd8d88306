"""Capture of a sensor: settings, frames, commands, figures."""

import threading
from typing import Any

import numpy as np
import pytest

from operators.capture import Capture, CaptureSettings
from pipeline.codec import dumps, loads
from pipeline.contract import inputs_of, outputs_of
from pipeline.errors import DriverError, PoolExhausted, SettingsError
from pipeline.messages import Frame, Truth
from pipeline.settings import build
from tests.drivers.contract import command, refuse
from tests.drivers.moving_square import MovingSquare

SCENE = "tests.drivers.moving_square:MovingSquare"


def capture(realtime: bool = False, **options: Any) -> Capture:
    subject = Capture(CaptureSettings(options={"scene": SCENE, "frames": 20} | options))
    subject.realtime = realtime
    return subject


def produced(subject: Capture) -> tuple[Frame, Frame]:
    frames = subject.produce()
    assert frames is not None
    context, roi = frames["context"], frames["roi"]
    assert isinstance(context, Frame)
    assert isinstance(roi, Frame)
    return context, roi


def test_it_has_two_streams_and_the_truth_and_takes_sensor_commands() -> None:
    further = dict.fromkeys(("roi_2", "roi_3", "roi_4"), Frame)

    pictures = {"context": Frame, "roi": Frame, **further, "full": Frame}
    assert outputs_of(Capture) == {**pictures, "truth": Truth}
    assert inputs_of(Capture)["schedule"].command


def test_both_streams_of_one_exposure_share_a_header() -> None:
    subject = capture()
    subject.open()

    context, roi = produced(subject)
    assert context.header is roi.header
    assert (context.pixels.shape, roi.pixels.shape) == ((48, 80, 3), (48, 80, 3))
    subject.close()


def test_further_windows_are_frames_of_outputs_of_their_own() -> None:
    subject = capture(rois=3, roi_area=0.015)
    subject.open()
    frames = subject.produce()
    subject.close()

    assert frames is not None
    assert list(frames) == ["context", "roi", "roi_2", "roi_3", "truth"]
    assert frames["roi_3"].header is frames["context"].header
    assert (subject.settings.rois, capture().settings.rois) == (3, 1)


def test_it_ends_with_its_source_and_releases_it() -> None:
    before = MovingSquare.open_sources
    subject = capture()
    subject.open()
    count = 0
    while subject.produce() is not None:
        count += 1
    subject.close()

    assert count == 20
    assert MovingSquare.open_sources == before
    assert subject.summary()["frames"]["exposed"] == 20


def test_a_command_from_another_thread_shapes_the_next_frame() -> None:
    subject = capture()
    subject.open()
    header = produced(subject)[0].header
    schedule = command(header.stream, made_from=0, first=1, windows=[(240, 144, 320, 192)])
    thread = threading.Thread(target=subject.on_schedule, args=(schedule,))
    thread.start()
    thread.join()

    assert produced(subject)[1].window == (240, 144, 320, 192)
    subject.close()


def test_a_lack_of_memory_is_raised_and_the_next_exposure_follows() -> None:
    subject = Capture(CaptureSettings(options={"scene": SCENE}), loan=refuse)
    subject.realtime = False
    subject.open()
    for _ in range(2):
        with pytest.raises(PoolExhausted):
            subject.produce()
    subject.close()

    assert subject.summary()["frames"]["overrun"] == 2


def test_it_keeps_the_sensors_rate_in_realtime() -> None:
    subject = capture(realtime=True, rate_hz=50, frames=500)  # a busy machine misses some
    subject.open()
    stamps = [produced(subject)[0].header.stamp_ns for _ in range(5)]
    subject.close()

    assert np.diff(stamps).min() > 0
    assert stamps[-1] - stamps[0] >= 79_000_000


def test_closing_and_asking_for_figures_is_safe_when_it_never_opened() -> None:
    before = MovingSquare.open_sources
    subject = capture()
    subject.close()

    assert MovingSquare.open_sources == before
    assert subject.summary() == {}
    with pytest.raises(DriverError, match="is not open"):
        subject.produce()


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"options": {"scene": "soccer", "sede": 3}}, r"capture\.options\.sede: .*'seed'\?"),
        ({"options": {"scene": "soccer", "seed": "x"}}, r"capture\.options\.seed: "),
        ({"options": {}}, r"capture\.options\.scene or source: expected exactly one of them"),
        ({"sensor": "Simulated"}, r"capture\.sensor: expected an import path"),
        ({"sensor": "nowhere:Sensor"}, r"capture\.sensor: nowhere:Sensor cannot be imported"),
        ({"sensor": "pathlib:Path"}, r"capture\.sensor: expected a DualStreamSensor"),
        (
            {"options": {"source": "drivers.datasets:VideoFile", "path": ""}},
            r"capture\.options\.path: required by drivers\.datasets:VideoFile, got nothing",
        ),
    ],
)
def test_wrong_settings_are_refused_with_their_place_before_anything_runs(
    values: dict[str, Any], named: str
) -> None:
    with pytest.raises(SettingsError, match=named):
        build(CaptureSettings, values, "capture")


def test_the_truth_of_a_source_is_sent_with_its_pictures() -> None:
    subject = capture()
    subject.open()
    frames = subject.produce()
    subject.close()

    assert frames is not None
    truth = frames["truth"]
    assert isinstance(truth, Truth)
    assert truth.header is frames["context"].header
    assert len(truth.boxes) == len(truth.ids) == len(truth.labels) == len(truth.visibility) > 0
    again = loads(Truth, dumps(truth))
    assert again.labels == truth.labels
    assert np.array_equal(again.visibility, truth.visibility)


def test_a_schedule_that_the_sensor_cannot_obey_is_counted_and_the_sensor_goes_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    subject = capture()
    subject.open()
    context, _ = produced(subject)
    twice = [[(0, 0, 80, 48)] * 2] * 4
    wrong = command(context.header.stream, made_from=0, first=1, windows=twice)

    for _ in range(3):
        subject.on_schedule(wrong)
    _, roi = produced(subject)
    subject.close()

    assert roi.status == "unplanned"
    assert subject.summary()["refused_schedules"] == 3
    assert subject.summary()["headline"].endswith("3 schedules were refused, as the log says")
    (said,) = caplog.messages
    assert said.startswith("schedule: expected 1 window in one exposure")
    assert said.endswith("got 2; it is not used, nor are others like it")
