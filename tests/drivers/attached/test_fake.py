"""The commands on Aravis' own fake camera: it is listed, and it passes."""

import json
from collections.abc import Iterator

import pytest

from tests.commands import command
from tests.drivers.genicam.streaming import FAKE, FakeCamera, needs_aravis
from tests.drivers.genicam.virtual_camera import loopback

pytestmark = needs_aravis()


@pytest.fixture(autouse=True)
def port() -> Iterator[None]:
    """The port of GigE cameras cannot be chosen: one test process at a time."""
    with loopback():
        yield


def test_it_is_listed_with_what_it_can_do() -> None:
    fake = FakeCamera()
    done = command("sensors", "--json")
    fake.kill()

    (kind,) = (kind for kind in json.loads(done.stdout)["kinds"] if kind["kind"] == "genicam")
    (found,) = kind["sensors"]
    assert (found["name"], found["foveates"], found["problem"]) == (f"genicam:{FAKE}", True, "")
    assert found["offers"][0] == {
        "pixel_format": "RGB8", "size_px": [2048, 2048], "rates_hz": [0.1, 1000.0], "ranged": True
    }  # fmt: skip


def test_it_passes_as_a_sensor_that_foveates() -> None:
    small = ("--set", "binning=16", "--set", "pixel_format=Mono8", "--seconds", "0.5", "--json")

    answer = json.loads(command("sensors", "test", "fake", *small).stdout)

    assert answer["sensor"] == "drivers.genicam:GenicamSensor"
    assert answer["passed"], answer


@pytest.mark.slow  # a plain camera is asked for its largest packet at each opening
def test_it_passes_as_a_plain_camera() -> None:
    fake = FakeCamera()
    options = ("camera_options.size_px=[64, 48]", "camera_options.rate_hz=25")
    words = [word for option in options for word in ("--set", option)]
    answer = json.loads(command("sensors", "test", "genicam", *words, "--json").stdout)
    fake.kill()

    assert answer["sensor"] == "drivers.cameras:CameraSensor"
    assert answer["passed"], answer
