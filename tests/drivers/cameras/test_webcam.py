"""Webcams: what is refused before OpenCV is asked, and devices on the desk (mark `hardware`)."""

import errno
import json
import os
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from drivers.cameras import CameraSensor, CameraSensorSettings, Webcam, WebcamSettings, v4l2
from drivers.cameras.opencv import OpenCvConnection, decoded, fourcc_of
from pipeline.cli import commands
from pipeline.errors import DriverError, SettingsError
from tests.drivers.contract import check_sensor

CARD = b"Integrated \x1b[31mCamera"


def refused(device: int | str) -> str:
    camera = Webcam(WebcamSettings(device=device))
    with pytest.raises(DriverError) as error:
        camera.open()
    camera.close()
    return str(error.value)


def capability(own: int) -> bytes:
    every = v4l2.CAPTURE | v4l2.META_CAPTURE | v4l2.STREAMING | v4l2.HAS_DEVICE_CAPS
    return struct.pack("=16s32s32sIII12x", b"uvcvideo", CARD, b"usb-1", 6, every, own)


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The kernel's answers for /dev/null, which stands in for a video device."""
    answers: dict[str, Any] = {"capability": capability(v4l2.CAPTURE | v4l2.STREAMING)}

    def ioctl(descriptor: int, request: int, memory: bytearray) -> int:
        if request == v4l2.QUERYCAP:
            memory[:] = answers["capability"]
        elif request == v4l2.REQBUFS and (code := answers.get("reqbufs")):
            raise OSError(code, os.strerror(code))
        return 0

    monkeypatch.setattr(v4l2.fcntl, "ioctl", ioctl)
    return answers


def test_the_numbers_of_requests_are_those_of_the_kernel() -> None:
    def request(direction: int, number: int, size: int) -> int:
        return direction << 30 | size << 16 | ord("V") << 8 | number  # asm-generic/ioctl.h

    assert request(2, 0, v4l2.CAPABILITY.size) == v4l2.QUERYCAP
    assert request(3, 8, 20) == v4l2.REQBUFS


def test_a_device_that_is_not_there_is_told_with_those_that_are() -> None:
    said = refused("/dev/video250")

    assert said.startswith("/dev/video250: no such device; ")
    assert said == f"/dev/video250: no such device; {v4l2.attached()}"


def test_attached_devices_are_told_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, name in ((10, "Other\n"), (2, "Integrated Camera\n")):
        folder = tmp_path / f"video{number}"
        folder.mkdir()
        (folder / "name").write_text(name)
    monkeypatch.setattr(v4l2, "NAMES", tmp_path)

    assert v4l2.attached() == "there is /dev/video2 (Integrated Camera), /dev/video10 (Other)"


@pytest.mark.parametrize("kind", ["file", "folder", "device"])
def test_what_is_no_video_device_is_refused(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    path = {"file": str(file), "folder": str(tmp_path), "device": "/dev/null"}[kind]

    assert refused(path) == f"{path}: expected a video device, got something else"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_a_device_without_permission_says_who_may_open_it(tmp_path: Path) -> None:
    file = tmp_path / "video"
    file.touch(mode=0o000)

    assert "no permission to open it; its group is " in refused(str(file))


@pytest.mark.parametrize("code", [errno.EACCES, errno.EPERM])
def test_a_missing_permission_is_told_with_the_way_to_get_it(code: int, tmp_path: Path) -> None:
    said = v4l2.why_not(str(tmp_path), OSError(code, ""))

    assert said.startswith("no permission to open it; its group is ")
    assert "sudo usermod -aG" in said
    assert v4l2.why_not("/none", OSError(code, "")).endswith("its owner must allow it")


def test_a_device_in_use_is_refused_before_opencv_waits_for_it(kernel: dict[str, Any]) -> None:
    kernel["reqbufs"] = errno.EBUSY

    assert refused("/dev/null") == "/dev/null: it is in use by another program"


def test_the_second_node_of_a_webcam_is_refused_by_its_own_abilities(
    kernel: dict[str, Any],
) -> None:
    kernel["capability"] = capability(v4l2.META_CAPTURE | v4l2.STREAMING)

    said = refused("/dev/null")

    assert said.startswith("/dev/null: expected a camera, got Integrated ")
    assert "which carries data about pictures; " in said
    assert "\x1b" not in said


def test_a_device_without_streaming_is_refused(kernel: dict[str, Any]) -> None:
    kernel["capability"] = capability(v4l2.CAPTURE)

    assert "expected a camera that streams" in refused("/dev/null")


def test_a_device_that_cannot_count_buffers_is_still_looked_at(kernel: dict[str, Any]) -> None:
    kernel["reqbufs"] = errno.EINVAL

    assert v4l2.look_at("/dev/null").startswith("Integrated ")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"device": -1}, "device: expected 0 to 255, got -1"),
        ({"device": "video0"}, "device: expected a number or a path, got 'video0'"),
        ({"size_px": (0, 480)}, "size_px: expected sides of 1 to 32768, got (0, 480)"),
        ({"rate_hz": -1.0}, "rate_hz: expected 0 to 1000, got -1"),
        ({"fourcc": "MJPEG"}, "fourcc: expected four letters, e.g. MJPG or YUYV, got 'MJPEG'"),
        ({"outage_s": 0.0}, "outage_s: expected 0.05 to 3600, got 0"),
    ],
)
def test_wrong_settings_of_a_webcam_are_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError) as error:
        WebcamSettings(**settings)

    assert said in str(error.value)


@pytest.mark.parametrize("code", [float("inf"), -1.0, 0.0, 2.0**40, 1.0])
def test_four_characters_that_are_none_are_empty(code: float) -> None:
    assert fourcc_of(code) == ""


@pytest.mark.parametrize("damage", ["truncated", "empty", "zeros", "text"])
def test_a_damaged_jpeg_is_no_frame(damage: str) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8)
    whole = cv2.imencode(".jpg", pixels)[1].reshape(-1)
    found = {
        "truncated": whole[: len(whole) // 2],
        "empty": whole[:0],
        "zeros": np.zeros_like(whole),
        "text": np.frombuffer(b"\xff\xd8 no picture \xff\xd9", np.uint8),
    }[damage]

    assert decoded(found) is None
    padded = np.concatenate([whole, np.zeros(7, np.uint8)])  # as some webcams send it
    intact = decoded(padded)
    assert intact is not None
    assert intact.shape == (48, 64, 3)


class SendingJpegs:
    """A VideoCapture of a webcam of 64x48 that sends the bytes of one JPEG."""

    def __init__(self, jpeg: bytes) -> None:
        self._jpeg = np.frombuffer(jpeg, np.uint8)
        self._told = {
            cv2.CAP_PROP_BACKEND: cv2.CAP_V4L2,
            cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*"MJPG"),
            cv2.CAP_PROP_FRAME_WIDTH: 64,
            cv2.CAP_PROP_FRAME_HEIGHT: 48,
        }

    def get(self, name: int) -> float:
        return float(self._told.get(name, 0))

    def set(self, name: int, value: float) -> bool:
        return True

    def retrieve(self, into: object) -> tuple[bool, NDArray[np.uint8]]:
        return True, self._jpeg


@pytest.mark.parametrize(
    ("stated_px", "whole"), [((64, 48), True), ((64 + 32768, 48), False), ((65500, 65500), False)]
)
def test_a_jpeg_of_another_size_is_a_damaged_frame(stated_px: tuple[int, int], whole: bool) -> None:
    jpeg = bytearray(cv2.imencode(".jpg", np.full((48, 64, 3), 99, np.uint8))[1])
    at = jpeg.index(b"\xff\xc0") + 5  # SOF0, ITU-T T.81, B.2.2
    jpeg[at : at + 4] = struct.pack(">HH", *reversed(stated_px))
    capture: Any = SendingJpegs(bytes(jpeg))
    connection = OpenCvConnection(capture, name="webcam", read_timeout_s=1)
    connection.ask(size_px=(64, 48), rate_hz=30, fourcc="MJPG")

    assert (connection.decode(None) is not None) == whole


@pytest.fixture
def device(request: pytest.FixtureRequest) -> str:
    """The device on the desk that `--camera` names."""
    found = str(request.config.getoption("--camera"))
    if not found:
        pytest.skip("no device: --camera=/dev/videoN says which")
    return found


def webcam(device: str, **options: Any) -> CameraSensor:
    return CameraSensor(
        CameraSensorSettings(
            camera="drivers.cameras:Webcam", camera_options={"device": device, **options}
        )
    )


@pytest.mark.hardware
@pytest.mark.parametrize("fourcc", ["", "MJPG", "YUYV"])
def test_a_real_device_keeps_the_contract_of_a_sensor(device: str, fourcc: str) -> None:
    check_sensor(lambda: webcam(device, fourcc=fourcc, size_px=[640, 480]))


@pytest.mark.hardware
def test_a_real_device_says_what_it_chose_and_delivers_it(device: str) -> None:
    camera = Webcam(WebcamSettings(device=device))
    told = camera.open()
    pictures = 0
    while pictures < 30:
        found = camera.read(2.0)
        assert found is not None
        assert found.pixels.shape[1::-1] == told.size_px
        pictures += 1
    camera.close()

    figures = camera.summary()
    assert figures["device"]
    assert figures["backend"] == "V4L2"
    assert figures["frames"]["delivered"] == 30
    assert figures["rate_hz"]["achieved"] > 0


@pytest.mark.hardware
def test_a_real_device_in_use_is_refused(device: str) -> None:
    first = Webcam(WebcamSettings(device=device))
    first.open()

    assert refused(device) == f"{device}: it is in use by another program"
    first.close()


@pytest.mark.hardware
def test_the_demo_runs_on_a_real_device(device: str, tmp_path: Path) -> None:
    """What `make demo SOURCE=webcam` runs, in one thread and small: a guest computes slowly."""
    frames, report = 2, tmp_path / "report.json"
    words = ["run", "tracking", "--source", "webcam", "--inline", "--frames", str(frames)]
    camera = "capture.camera_options"
    changes = [f"{camera}.device={device}", f"{camera}.size_px=[640,360]"]
    changes += ["saliency.input_px=[96,64]"]  # 480x288 take ten seconds a frame there
    sets = [word for change in changes for word in ("--set", change)]

    result = CliRunner().invoke(commands, [*words, *sets, "--report", str(report)])

    assert result.exit_code == 0, result.output
    edges = {edge["to"]: edge for edge in json.loads(report.read_text())["edges"]}
    assert {"saliency.frame", "policy.tracks", "capture.schedule", "tracker.roi"} <= set(edges)
    assert {to: edge["delivered"] for to, edge in edges.items()} == dict.fromkeys(edges, frames)
