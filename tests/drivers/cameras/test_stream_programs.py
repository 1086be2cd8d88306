"""Streams of other people's programs: FFmpeg over MPEG-TS, GStreamer's RTSP server with a user.

Skipped where the program is absent (Debian: ffmpeg; python3-gi gir1.2-gst-rtsp-server-1.0
gstreamer1.0-plugins-good).
"""

import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.cameras import CameraSensor, CameraSensorSettings, NetworkStream, NetworkStreamSettings
from drivers.contract import (
    Make,
    check_commands_shape_the_frames_they_name,
    check_sensor,
)
from pipeline.errors import DriverError

SYSTEM_PYTHON = "/usr/bin/python3"  # Debian's bindings of GStreamer belong to it
RTSP_SERVER = """
import sys
import gi
gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer
Gst.init(None)
server = GstRtspServer.RTSPServer(service=sys.argv[1], address="127.0.0.1")
factory = GstRtspServer.RTSPMediaFactory(shared=True)
factory.set_launch(
    "( videotestsrc is-live=true pattern=ball"
    " ! video/x-raw,format=I420,width=320,height=192,framerate=30/1"
    " ! jpegenc ! rtpjpegpay name=pay0 pt=26 )"
)
role = GstRtspServer.RTSPToken()
role.set_string("media.factory.role", "viewer")
rights = "viewer, media.factory.access=(boolean)true, media.factory.construct=(boolean)true"
made = Gst.Structure.new_from_string(rights)
factory.add_role_from_structure(made[0] if isinstance(made, tuple) else made)
auth = GstRtspServer.RTSPAuth()
auth.add_basic(GstRtspServer.RTSPAuth.make_basic("joe", "p@ss:w/rd"), role)
server.set_auth(auth)
server.get_mount_points().add_factory("/live", factory)
server.attach(None)
print("listening", flush=True)
GLib.MainLoop().run()
"""
QUICK = {"open_timeout_s": 30.0, "read_timeout_s": 1.0, "outage_s": 60.0, "backoff_s": (0.05, 0.2)}


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@contextmanager
def running(*command: str, wait_for: str = "") -> Iterator[subprocess.Popen[str]]:
    """A program until the end of the block; `wait_for` is a line that says it is ready."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        if wait_for:
            assert process.stdout is not None
            assert process.stdout.readline().strip() == wait_for
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def ffmpeg() -> str:
    found = shutil.which("ffmpeg")
    if found is None:
        pytest.skip("no program ffmpeg")
    return found


@pytest.fixture
def rtsp_server() -> list[str]:
    probe = 'import gi; gi.require_version("GstRtspServer", "1.0")'
    try:
        subprocess.run([SYSTEM_PYTHON, "-c", probe], check=True, capture_output=True, timeout=30)
    except (OSError, subprocess.SubprocessError):
        pytest.skip("no RTSP server of GStreamer")
    return [SYSTEM_PYTHON, "-c", RTSP_SERVER]


def film(program: str, output: str, *, size: str = "320x192") -> list[str]:
    """FFmpeg sends a moving test picture as MPEG-TS with a key frame every half second."""
    source = ["-re", "-f", "lavfi", "-i", f"testsrc=size={size}:rate=30"]
    coder = ["-c:v", "mpeg2video", "-g", "15", "-b:v", "2M"]
    return [program, "-v", "error", *source, *coder, "-f", "mpegts", output]


def stream(url: str, **settings: Any) -> NetworkStream:
    return NetworkStream(NetworkStreamSettings(**{"url": url, **QUICK, **settings}))


def frames_of(camera: NetworkStream, count: int) -> list[np.ndarray]:
    found = []
    while len(found) < count:
        picture = camera.read(30.0)
        assert picture is not None
        found.append(picture.pixels.copy())
    return found


def test_mpeg_ts_over_udp_is_read_and_found_again_after_a_pause(ffmpeg: str) -> None:
    url = f"udp://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    camera = stream(url)
    with running(*film(ffmpeg, f"{url}?pkt_size=1316")):
        told = camera.open()
        first, second = frames_of(camera, 2)
    while camera.summary()["attempts"] < 2:
        camera.read(0.1)
    with running(*film(ffmpeg, f"{url}?pkt_size=1316")):
        frames_of(camera, 3)
    camera.close()

    assert (told.size_px, told.rate_hz) == ((320, 192), 30.0)
    assert not np.array_equal(first, second)
    assert camera.summary()["reconnects"] >= 1
    assert "it sent nothing for " in camera.summary()["outages"]["newest"][0]["reason"]


def test_mpeg_ts_over_tcp_that_changes_its_size_is_an_error(ffmpeg: str) -> None:
    port = free_port()
    url = f"tcp://127.0.0.1:{port}"
    camera = stream(url, open_wait_s=60.0)
    with running(*film(ffmpeg, f"{url}?listen=1")):
        camera.open()
        frames_of(camera, 2)
    with (
        running(*film(ffmpeg, f"{url}?listen=1", size="640x384")),
        pytest.raises(DriverError, match="expected frames of 320x192 as at the start, got 640x384"),
    ):
        frames_of(camera, 1000)
    camera.close()


def test_rtsp_with_a_user_gives_a_sensor_that_takes_commands(
    rtsp_server: list[str], tmp_path: Path
) -> None:
    port = free_port()
    with running(*rtsp_server, str(port), wait_for="listening"):
        check_commands_shape_the_frames_they_name(with_user(port, tmp_path))


@pytest.mark.slow
def test_rtsp_with_a_user_keeps_the_contract_of_a_sensor(
    rtsp_server: list[str], tmp_path: Path
) -> None:
    port = free_port()
    with running(*rtsp_server, str(port), wait_for="listening"):
        check_sensor(with_user(port, tmp_path))


def with_user(port: int, folder: Path) -> Make:
    """Makes sensors over the RTSP server on a port."""
    file = folder / "camera"
    file.write_text("joe:p@ss:w/rd\n")
    file.chmod(0o600)
    options = {"url": f"rtsp://127.0.0.1:{port}/live", "credentials_path": str(file), **QUICK}
    settings = CameraSensorSettings(camera="drivers.cameras:NetworkStream", camera_options=options)
    return lambda: CameraSensor(settings)


def test_rtsp_refusals_have_reasons_and_a_restarted_server_is_found_again(
    rtsp_server: list[str],
) -> None:
    port = free_port()
    place = f"127.0.0.1:{port}"
    camera = stream(f"rtsp://joe:p%40ss%3Aw%2Frd@{place}/live")
    said = []
    with running(*rtsp_server, str(port), wait_for="listening"):
        for who, path in (("", "live"), ("joe:wrong@", "live")):
            with pytest.raises(DriverError) as error:
                stream(f"rtsp://{who}{place}/{path}").open()
            said.append(str(error.value))
        camera.open()
        frames_of(camera, 3)
    while camera.read(0.3) is not None:
        pass
    with running(*rtsp_server, str(port), wait_for="listening"):
        frames_of(camera, 3)
    camera.close()

    shown = f"rtsp://{place}/live"
    assert said == [
        f"{shown}: the server asks for a user and a password (401)",
        f"{shown}: the server refuses this user or password (401)",
    ]
    assert camera.source == shown
    assert camera.summary()["reconnects"] == 1
