"""A stream of an independent HTTP server: the contract, outages, refusals, secrets."""

import logging
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import cv2
import pytest

from drivers.camera import Picture
from drivers.cameras import (
    CameraSensor,
    CameraSensorSettings,
    NetworkStream,
    NetworkStreamSettings,
    opencv,
)
from pipeline.errors import DriverError
from tests.drivers.contract import check_sensor
from tests.drivers.mjpeg_server import MjpegServer
from tests.drivers.numbered import number_of

SECRET = "Xq7-secret"
QUICK = {
    "open_timeout_s": 20.0,
    "read_timeout_s": 0.5,
    "outage_s": 60.0,
    "backoff_s": (0.02, 0.1),
}


@pytest.fixture
def server() -> Iterator[MjpegServer]:
    found = MjpegServer()
    yield found
    found.stop()


def stream(url: str, **settings: Any) -> NetworkStream:
    return NetworkStream(NetworkStreamSettings(**{"url": url, **QUICK, **settings}))


def next_of(camera: NetworkStream) -> Picture:
    found = camera.read(30.0)
    assert found is not None
    return found


def read_on(camera: NetworkStream) -> None:
    while True:
        camera.read(1.0)


def shown(picture: Picture) -> int:
    return number_of(picture.pixels)


def refused(camera: NetworkStream) -> str:
    with pytest.raises(DriverError) as error:
        camera.open()
    camera.close()
    return str(error.value)


def test_a_stream_keeps_the_contract_of_a_sensor(server: MjpegServer) -> None:
    def make() -> CameraSensor:
        return CameraSensor(
            CameraSensorSettings(
                camera="drivers.cameras:NetworkStream",
                camera_options={"url": server.url, "open_timeout_s": 30, "outage_s": 60},
                read_timeout_s=60,
            )
        )

    check_sensor(make)


def test_an_open_stream_states_its_size_and_not_how_many_bytes_cross(server: MjpegServer) -> None:
    camera = stream(server.url)
    told = camera.open()
    expected = camera.expected()
    camera.close()

    assert expected is not None
    assert expected.negotiated == told
    (crossing,) = expected.link.streams
    assert (crossing.size_px, crossing.pixel_format, crossing.frame_bytes) == (
        (320, 192), "MJPG", None,
    )  # fmt: skip


def test_it_says_what_was_negotiated_and_shows_the_frames_that_were_sent(
    server: MjpegServer,
) -> None:
    camera = stream(server.url)
    told = camera.open()
    first = next_of(camera)
    number = shown(first)  # a picture is valid until the next one
    second = next_of(camera)
    left_to_right = second.pixels[100, 10:310, 2].astype(int)  # BGR: red rises
    following = shown(second)
    camera.close()

    assert (told.size_px, told.pixel_format) == ((320, 192), "bgr8")
    assert (told.rate_hz, told.transport) == (0.0, "FFmpeg, MJPG")
    assert following == number + 1 + second.skipped
    assert first.stamp_ns < second.stamp_ns
    assert left_to_right[-1] - left_to_right[0] > 150


def test_a_server_that_dies_and_comes_back_is_found_again(
    server: MjpegServer, caplog: pytest.LogCaptureFixture
) -> None:
    camera = stream(server.url)
    camera.open()
    before = shown(next_of(camera))
    with caplog.at_level(logging.WARNING):
        server.stop()
        while (found := camera.read(0.3)) is not None:
            before = shown(found)
        again = MjpegServer(port=server.port, first=5000)
        after = [next_of(camera) for _ in range(3)]
        camera.close()
        again.stop()

    figures = camera.summary()
    assert before < 5000 <= shown(after[0])
    assert figures["reconnects"] == figures["outages"]["count"] == 1
    assert figures["outages"]["newest"][0]["reason"] == "the stream ended"
    assert figures["outages"]["total_s"] > 0.2
    assert len(caplog.records) == 2
    frames = figures["frames"]
    waiting = frames["arrived"] - frames["delivered"] - frames["unread"] - frames["damaged"]
    assert waiting in (0, 1)


def test_a_server_that_falls_silent_is_asked_again(server: MjpegServer) -> None:
    camera = stream(server.url)
    camera.open()
    next_of(camera)
    server.silent.set()
    while camera.read(0.3) is not None:
        pass
    while server.clients < 2:
        camera.read(0.05)
    server.silent.clear()
    next_of(camera)
    camera.close()

    assert "it sent nothing for 0." in camera.summary()["outages"]["newest"][0]["reason"]


def test_a_stream_that_ends_is_an_outage_that_is_given_up() -> None:
    server = MjpegServer(frames=5)
    camera = stream(server.url, outage_s=0.3)
    camera.open()
    server.stop()
    with pytest.raises(DriverError, match=r"more than outage_s, 0\.3: "):
        read_on(camera)
    camera.close()


def test_a_server_that_comes_back_with_another_size_is_an_error(server: MjpegServer) -> None:
    camera = stream(server.url)
    camera.open()
    server.stop()
    again = MjpegServer(port=server.port, size_px=(640, 384))
    with pytest.raises(DriverError, match="expected frames of 320x192 as at the start, got 640x"):
        read_on(camera)
    camera.close()
    again.stop()


def test_a_grey_camera_has_three_equal_channels() -> None:
    server = MjpegServer(grey=True)
    camera = stream(server.url)
    camera.open()
    pixels = next_of(camera).pixels
    camera.close()
    server.stop()

    assert pixels.shape == (192, 320, 3)
    assert (pixels == pixels[..., :1]).all()


def test_a_server_is_opened_with_user_and_password_from_a_file(tmp_path: Any) -> None:
    server = MjpegServer(user="joe:p@ss/w:rd")
    file = tmp_path / "camera"
    file.write_text("joe:p@ss/w:rd\n")
    file.chmod(0o600)
    camera = stream(server.url, credentials_path=str(file))
    camera.open()
    next_of(camera)
    camera.close()
    server.stop()

    assert camera.source == server.url


def test_refusals_have_reasons_in_words(server: MjpegServer) -> None:
    guarded = MjpegServer(user=f"joe:{SECRET}")
    place = f"127.0.0.1:{guarded.port}"
    free = socket.create_server(("127.0.0.1", 0))
    nobody = free.getsockname()[1]
    free.close()

    said = {
        "asks": refused(stream(guarded.url)),
        "wrong": refused(stream(f"http://joe:nonsense@{place}/stream")),
        "path": refused(stream(f"http://127.0.0.1:{server.port}/other")),
        "nobody": refused(stream(f"rtsp://joe:{SECRET}@127.0.0.1:{nobody}/live")),
        "tcp": refused(stream(f"tcp://127.0.0.1:{nobody}")),
        "name": refused(stream("rtsp://no-such-host.invalid/live")),
        "udp": refused(stream(f"udp://@127.0.0.1:{nobody}", open_timeout_s=0.3)),
    }  # fmt: skip
    guarded.stop()

    assert said == {
        "asks": f"http://{place}/stream: the server asks for a user and a password (401)",
        "wrong": f"http://{place}/stream: the server refuses this user or password (401)",
        "path": f"http://127.0.0.1:{server.port}/other: the server has no stream of this path "
        "(404)",
        "nobody": f"rtsp://127.0.0.1:{nobody}/live: the host refuses the connection: nothing "
        f"listens on port {nobody}",
        "tcp": f"tcp://127.0.0.1:{nobody}: no video comes from port {nobody}; does anything listen "
        "there?",
        "name": "rtsp://no-such-host.invalid/live: there is no host of the name "
        "no-such-host.invalid",
        "udp": f"udp://127.0.0.1:{nobody}: no video arrived on port {nobody} within 0.3 s",
    }


def test_what_is_no_video_is_refused() -> None:
    server = MjpegServer(frames=20)
    server.broken.set()
    said = refused(stream(server.url, open_timeout_s=1.0))
    server.stop()

    assert said.startswith(server.url + ": ")


def test_a_host_that_accepts_and_is_silent_is_given_up_in_time() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        said = refused(stream(f"http://127.0.0.1:{port}/", open_timeout_s=0.3))

    assert said == (
        f"http://127.0.0.1:{port}/: the host answers on port {port}, but sends no video in 0.3 s"
    )


def test_a_pipeline_without_gstreamer_is_refused_with_the_way_out() -> None:
    if opencv.has(opencv.GSTREAMER):
        pytest.skip("this OpenCV has GStreamer")

    said = refused(NetworkStream(NetworkStreamSettings(pipeline="videotestsrc ! appsink")))

    assert said.startswith(f"pipeline: expected an OpenCV with GStreamer, got {cv2.__version__}")


def test_no_library_writes_a_password_to_the_terminal(server: MjpegServer) -> None:
    guarded = MjpegServer(user="joe:other")
    script = """
import logging, sys
from drivers.cameras import NetworkStream, NetworkStreamSettings
from pipeline.errors import DriverError
logging.basicConfig(level=logging.DEBUG)
for url in sys.argv[1:]:
    camera = NetworkStream(NetworkStreamSettings(url=url, open_timeout_s=0.5, read_timeout_s=0.3))
    try:
        camera.open()
        camera.read(1.0)
    except DriverError as error:
        print(error)
    camera.close()
    print(camera.summary())
"""
    who = f"joe:{SECRET}"
    urls = [
        f"http://{who}@127.0.0.1:{server.port}/stream?pwd={SECRET}",
        f"http://{who}@127.0.0.1:{guarded.port}/stream",
        f"http://{who}@127.0.0.1:{server.port}/other",
        f"rtsp://{who}@127.0.0.1:{server.port}/stream",
        f"tcp://{who}@127.0.0.1:{server.port}",
        f"rtsp://{who}@no-such-host.invalid/live?pwd={SECRET}",
    ]
    done = subprocess.run(
        [sys.executable, "-c", script, *urls],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    guarded.stop()

    assert done.stdout.count("'attempts'") == len(urls)
    assert SECRET not in done.stdout + done.stderr
