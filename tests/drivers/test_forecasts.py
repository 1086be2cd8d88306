"""What sensors state of their streams is what they send, before they are open and then."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import DTypeLike, NDArray

from drivers.cameras import CameraSensor, CameraSensorSettings
from drivers.cameras.webcam import Webcam, WebcamSettings
from drivers.genicam import GenicamCamera, GenicamCameraSettings, GenicamSensor
from drivers.genicam.sensor_settings import GenicamSensorSettings
from drivers.sensor import DualStreamSensor, StatesStreams
from drivers.simulated import SimulatedSensor, SimulatedSensorSettings
from drivers.usb import DualStreamBoard, DualStreamBoardSettings
from pipeline.errors import SettingsError
from pipeline.forecast import Forecast
from pipeline.settings import build
from tests.drivers.usb.boards import board

SQUARE = "tests.drivers.moving_square:MovingSquare"
CAMERA = "tests.drivers.cameras.synthetic_camera:SyntheticCamera"
PAPER = {"profile": "paper-live", "scene": SQUARE}


def simulated(**settings: Any) -> SimulatedSensor:
    values = {"scene": SQUARE, "size_px": (320, 192), "rate_hz": 100, **settings}
    return SimulatedSensor(build(SimulatedSensorSettings, values, "options"))


def paper(**settings: Any) -> DualStreamBoard:
    values = {"backend": "drivers.virtual_board:VirtualBackend", "backend_options": PAPER}
    return DualStreamBoard(build(DualStreamBoardSettings, {**values, **settings}, "options"))


def camera_sensor(**settings: Any) -> CameraSensor:
    values = {"camera": CAMERA, "camera_options": {"rate_hz": 50.0}, **settings}
    return CameraSensor(build(CameraSensorSettings, values, "options"))


def stated(sensor: object) -> Forecast:
    assert isinstance(sensor, StatesStreams)
    return sensor.forecast()


def sent(sensor: DualStreamSensor) -> tuple[Forecast, dict[str, tuple[Any, ...]]]:
    """Return what an open sensor states, and size, format and bytes of the pictures it sends."""

    def memory(
        _output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        return np.empty(shape, dtype)

    sensor.open(realtime=False)
    try:
        told = stated(sensor)
        sensor.start()
        exposure = sensor.read(memory)
    finally:
        sensor.close()
    assert exposure is not None
    frames = {"context": exposure.context, "roi": exposure.roi}
    return told, {n: (f.size_px, f.pixel_format, f.pixels.nbytes) for n, f in frames.items()}


@pytest.mark.parametrize(
    "make",
    [
        simulated,
        lambda: simulated(mosaic=True, pixel_format="bayer_grbg10p", size_px=(330, 194)),
        lambda: simulated(roi_scale=0.5, noise=1.0),
        lambda: simulated(strategy="full"),
        lambda: simulated(strategy="temporal"),
        lambda: board(pixel_format="bayer_rggb12p"),
        lambda: board(roi_px=(160, 96)),
        board,
        camera_sensor,
        lambda: camera_sensor(camera_options={"pixel_format": "bayer_rggb8"}, roi_scale=0.5),
    ],
)
def test_pictures_are_as_they_were_stated(make: Callable[[], Any]) -> None:
    told, pictures = sent(make())

    for name, (size_px, pixel_format, nbytes) in pictures.items():
        stream = told.streams[name]
        assert (stream.size_px, stream.frame_bytes) == (size_px, nbytes), name
        # a mosaic that is cropped at odd pixels has the order of another first pixel
        assert stream.pixel_format[-3:] == pixel_format[-3:], name


@pytest.mark.parametrize("make", [simulated, board, lambda: simulated(latency_frames=3)])
def test_what_the_settings_tell_is_what_the_open_sensor_tells(make: Callable[[], Any]) -> None:
    closed = stated(make())

    assert closed == sent(make())[0]
    assert closed.streams["context"].rate_hz == 100


def test_the_source_is_not_opened_for_what_the_settings_leave_out() -> None:
    told = stated(simulated(size_px=(0, 0), rate_hz=0))

    assert not told.streams
    assert told.note == f"{SQUARE} is not opened for its size_px and rate_hz"
    opened = sent(simulated(size_px=(0, 0), rate_hz=0))[0]
    assert opened.streams["context"].size_px == (80, 48)
    assert opened.rate_hz == 100


def test_frames_that_are_left_out_are_no_exposures() -> None:
    told = stated(simulated(strategy="temporal", budget=0.25))

    assert told.rate_hz == told.streams["context"].rate_hz == 25


@pytest.mark.parametrize(("depth", "mega"), [("8", 351), ("10p", 439), ("16", 703)])
def test_the_virtual_board_of_the_paper_states_its_link_without_being_opened(
    depth: str, mega: int
) -> None:
    told = stated(paper(pixel_format=f"bayer_rggb{depth}"))

    assert told.link is not None
    needs = [stream.bytes_per_s or 0 for stream in told.link.streams]
    assert round(sum(needs) / 1e6) == mega
    assert told.link.carries_bytes_per_s == 400e6
    assert told.readout_frames == pytest.approx(1 + sum(needs) / 400e6)


def test_a_link_that_the_user_knows_better_counts() -> None:
    told = stated(paper(link_bytes_per_s=1_000_000_000))

    assert told.link is not None
    assert told.link.carries_bytes_per_s == 1e9


def test_the_board_of_the_paper_sends_previews_while_it_records() -> None:
    options = {**PAPER, "profile": "paper-prototype"}
    told = stated(paper(mode="record", pixel_format="bayer_rggb8", backend_options=options))

    assert told.link is not None
    assert [stream.rate_hz for stream in told.link.streams] == [7.5]
    assert (told.rate_hz, told.readout_frames) == (30, 28.7)
    assert "a burst of 105 frames is 1230 MB, 3.07 s on the link" in told.note


def test_a_mode_that_the_board_does_not_have_is_refused_before_it_is_opened() -> None:
    with pytest.raises(SettingsError, match="mode: expected live, as the board can, got record"):
        stated(paper(mode="record"))


def test_a_board_that_nothing_is_known_of_states_nothing() -> None:
    told = stated(DualStreamBoard(DualStreamBoardSettings(rate_hz=30)))

    assert (dict(told.streams), told.link) == ({}, None)
    assert told.note


def test_a_camera_that_does_not_tell_leaves_its_streams_unknown() -> None:
    told = stated(camera_sensor())

    assert not told.streams
    assert "once it is open" in told.note


@pytest.mark.parametrize(
    ("fourcc", "nbytes"), [("YUYV", 4_147_200), ("NV12", 3_110_400), ("MJPG", None), ("", None)]
)
def test_a_webcam_states_what_it_is_asked_for(fourcc: str, nbytes: int | None) -> None:
    options = {"fourcc": fourcc, "rate_hz": 30}
    told = stated(camera_sensor(camera="drivers.cameras:Webcam", camera_options=options))

    assert told.link is not None
    (crossing,) = told.link.streams
    assert (crossing.size_px, crossing.frame_bytes) == ((1920, 1080), nbytes)
    assert told.streams["context"].size_px == (480, 270)
    assert told.streams["roi"].rate_hz == 30


def test_a_webcam_that_may_choose_its_size_states_nothing() -> None:
    assert Webcam(WebcamSettings(size_px=(0, 0))).expected() is None


def test_the_slower_of_sensor_and_camera_gives_the_rate() -> None:
    options = {"camera": "drivers.cameras:Webcam", "camera_options": {"rate_hz": 30}}

    assert stated(camera_sensor(**options, rate_hz=10)).rate_hz == 10
    assert stated(camera_sensor(**options, rate_hz=60)).rate_hz == 30


def test_a_network_stream_states_nothing_before_it_is_open() -> None:
    options = {"url": "rtsp://camera.local/1"}
    told = stated(camera_sensor(camera="drivers.cameras:NetworkStream", camera_options=options))

    assert not told.streams


def test_an_industrial_camera_states_what_it_is_asked_for_if_that_is_everything() -> None:
    asked = GenicamCameraSettings(size_px=(640, 480), pixel_format="BayerRG16", rate_hz=20)
    expected = GenicamCamera(asked).expected()

    assert expected is not None
    (crossing,) = expected.link.streams
    assert (crossing.frame_bytes, crossing.rate_hz, expected.link.kind) == (614_400, 20, "")
    assert GenicamCamera(GenicamCameraSettings(size_px=(640, 480))).expected() is None


def test_an_industrial_camera_that_foveates_states_its_rate_alone_before_it_is_open() -> None:
    told = stated(GenicamSensor(GenicamSensorSettings(rate_hz=20)))

    assert (dict(told.streams), told.rate_hz) == ({}, 20)


def test_nothing_is_opened_to_state_streams(tmp_path: Path) -> None:
    path = str(tmp_path / "none.mp4")
    told = stated(simulated(scene="", source="drivers.datasets:VideoFile", path=path))

    assert told.streams["context"].size_px == (80, 48)
