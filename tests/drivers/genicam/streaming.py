"""What the tests of streaming cameras share: cameras to open, and Aravis' own fake one."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.camera import Picture
from drivers.genicam import (
    GenicamCamera,
    GenicamCameraSettings,
    GenicamSensor,
    GenicamSensorSettings,
)
from drivers.genicam.aravis import library
from pipeline.errors import InstallError

FAKE, VIRTUAL = "Aravis-Fake-F1", "Fovea-Virtual-V1"
ROOT = Path(__file__).resolve().parents[3]


def needs_aravis() -> pytest.MarkDecorator:
    """Skip the tests of a file, with the reason, where the library is not installed."""
    try:
        library()
    except InstallError as missing:
        return pytest.mark.skip(reason=str(missing))
    return pytest.mark.skipif(False, reason="")


class FakeCamera:
    """Aravis' fake camera as a process of its own, which may be killed and started again."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "drivers.genicam.fake_camera"]
        self._process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


def camera(name: str = FAKE, **settings: Any) -> GenicamCamera:
    return GenicamCamera(GenicamCameraSettings(camera=name, **settings))


def sensor(name: str = VIRTUAL, **settings: Any) -> GenicamSensor:
    return GenicamSensor(GenicamSensorSettings(camera=name, **settings))


@contextlib.contextmanager
def streaming(made: GenicamCamera) -> Iterator[GenicamCamera]:
    made.open()
    try:
        yield made
    finally:
        made.close()


def next_picture(made: GenicamCamera, timeout_s: float = 10.0) -> Picture:
    found = made.read(timeout_s)
    assert found is not None
    return found
