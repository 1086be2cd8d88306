"""Streaming from the fake GigE camera of Aravis, over the loopback: plain and foveating."""

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from drivers.camera import Picture
from drivers.genicam import discover
from pipeline.errors import DriverError
from tests.drivers.contract import check_sensor
from tests.drivers.genicam.streaming import (
    FAKE,
    FakeCamera,
    camera,
    needs_aravis,
    next_picture,
    sensor,
    streaming,
)
from tests.drivers.genicam.virtual_camera import (
    loopback,
)

pytestmark = needs_aravis()


@pytest.fixture(scope="module", autouse=True)
def port() -> Iterator[None]:
    """The port of GigE cameras cannot be chosen: one test process at a time."""
    with loopback():
        yield


@pytest.fixture(scope="module")
def fake() -> Iterator[FakeCamera]:
    made = FakeCamera()
    yield made
    made.kill()


def test_the_fake_camera_is_listed_with_what_it_can_do(fake: FakeCamera) -> None:
    (found,) = discover()

    assert (found.id, found.protocol, found.address) == (FAKE, "GigEVision", "127.0.0.1")
    assert (found.vendor, found.model, found.serial) == ("Aravis", "Fake", "F1")
    assert (found.field_px, found.problem) == ((2048, 2048), "")
    assert found.pixel_formats[0] == "RGB8"
    assert (found.foveation.means, found.foveation.reduction) == ("writes", "Binning")


@pytest.mark.parametrize("name", [FAKE, "F1", "127.0.0.1", ""])
def test_a_camera_is_found_by_id_serial_address_or_as_the_only_one(
    fake: FakeCamera, name: str
) -> None:
    with streaming(camera(name)) as made:
        assert next_picture(made).pixels.shape == (512, 512)


@pytest.mark.parametrize(
    ("pixel_format", "ours", "shape", "dtype"),
    [
        ("Mono8", "grey8", (48, 64), np.uint8),
        ("RGB8", "rgb8", (48, 64, 3), np.uint8),
        ("BayerRG8", "bayer_rggb8", (48, 64), np.uint8),
        ("BayerGB8", "bayer_gbrg8", (48, 64), np.uint8),
        ("Mono16", "grey16", (48, 64), np.uint16),
    ],
)
def test_frames_come_in_the_format_and_size_asked_for(
    fake: FakeCamera, pixel_format: str, ours: str, shape: tuple[int, ...], dtype: type
) -> None:
    made = camera(pixel_format=pixel_format, size_px=(64, 48), rate_hz=100)
    told = made.open()
    found = next_picture(made).pixels
    made.close()

    assert (told.size_px, told.pixel_format, told.rate_hz) == ((64, 48), ours, 100)
    assert told.transport == f"GigE Vision, {pixel_format}"
    assert (found.shape, found.dtype) == (shape, dtype)
    assert np.ptp(found) > 20


def test_frames_are_those_of_the_camera_and_never_come_twice(fake: FakeCamera) -> None:
    made = camera(pixel_format="Mono8", size_px=(64, 48), rate_hz=100)
    with streaming(made):
        before_ns = time.monotonic_ns()
        taken = [next_picture(made) for _ in range(10)]
        firsts = [int(picture.pixels[0, 0]) for picture in taken[-1:]]
        stamps = [picture.stamp_ns for picture in taken]
        skipped = sum(picture.skipped for picture in taken)

    assert stamps == sorted(set(stamps))
    assert before_ns - 1e9 < stamps[0] <= stamps[-1] <= time.monotonic_ns()
    assert firsts[0] in range(256)
    assert made.summary()["frames"] == {
        "delivered": 10, "skipped": skipped, "incomplete": 0, "unfitting": 0
    }  # fmt: skip
    assert made.summary()["stamps"] == "camera"


def test_features_are_written_by_name_and_refused_in_a_sentence(fake: FakeCamera) -> None:
    with streaming(camera(features={"ExposureTimeAbs": 5000, "PixelFormat": "Mono8"})) as made:
        next_picture(made)
    for features, sentence in (
        ({"ExposureTime": 5}, "no feature ExposureTime, did you mean 'ExposureTimeAbs'?"),
        ({"ExposureTimeAbs": 1e12}, "ExposureTimeAbs: expected 10 to 1e+07, got 1e+12"),
        ({"Width": "wide"}, "Width: expected a whole number, got 'wide'"),
        ({"Width": True}, "Width: expected a whole number, got True"),
        ({"PixelFormat": "Mono9"}, "PixelFormat: expected one of BayerBG8, "),
        ({"PixelFormat": 5}, "PixelFormat: expected a text, got 5"),
    ):
        with pytest.raises(DriverError) as caught:
            camera(features=features).open()
        assert str(caught.value).startswith(f"{FAKE}: ")
        assert sentence in str(caught.value)


def test_a_camera_that_is_not_there_is_named_with_those_that_are(fake: FakeCamera) -> None:
    with pytest.raises(DriverError, match=f"camera Nobody: .*; attached: {FAKE}"):
        camera("Nobody").open()


def test_close_ends_a_read_that_waits(fake: FakeCamera) -> None:
    made = camera(features={"TriggerMode": "On", "TriggerSource": "Software"})
    made.open()
    answers: list[Picture | None] = []
    waiting = threading.Thread(target=lambda: answers.append(made.read(60)))
    waiting.start()
    made.close()
    waiting.join(10)
    restored = camera(features={"TriggerMode": "Off"})
    with streaming(restored):
        next_picture(restored)

    assert answers == [None]
    assert made.read(0.1) is None


def test_a_camera_that_dies_comes_back(fake: FakeCamera) -> None:
    made = camera(size_px=(64, 48), rate_hz=100, absent_s=60)
    with streaming(made):
        next_picture(made)
        fake.kill()
        while made.summary()["losses"] == 0:
            made.read(0.1)
        began_s = time.monotonic()
        assert made.read(0.05) is None
        waited_s = time.monotonic() - began_s
        fake.start()
        back = next_picture(made, 60)

    assert back.pixels.shape == (48, 64)
    assert waited_s < 1
    assert made.summary()["losses"] == 1


def test_aravis_fake_camera_keeps_the_contract_of_a_sensor(fake: FakeCamera) -> None:
    check_sensor(lambda: sensor(FAKE, binning=16, pixel_format="Mono8"))


def test_what_was_asked_of_a_camera_is_what_it_tells_once_it_is_open(fake: FakeCamera) -> None:
    made = camera(pixel_format="Mono16", size_px=(64, 48), rate_hz=100)
    asked = made.expected()
    with streaming(made):
        told = made.expected()
        nbytes = next_picture(made).pixels.nbytes

    assert asked is not None
    assert told is not None
    assert (told.link.streams, told.link.kind) == (asked.link.streams, "")  # it tells no speed
    assert told.link.streams[0].frame_bytes == nbytes == 6144


def test_a_foveating_camera_states_the_pictures_that_it_sends(fake: FakeCamera) -> None:
    made = sensor(FAKE, binning=16, pixel_format="Mono8", rate_hz=5)
    made.open(realtime=False)
    told = made.forecast()
    made.start()
    exposure = made.read(lambda _output, shape, dtype: np.empty(shape, dtype))
    made.close()

    assert exposure is not None
    assert told.link is not None
    sent = [frame.pixels.nbytes for frame in (exposure.context, exposure.roi)]
    assert [stream.frame_bytes for stream in told.link.streams] == sent
    assert {stream.rate_hz for stream in told.streams.values()} == {5}
    assert told.lead_frames >= 1
