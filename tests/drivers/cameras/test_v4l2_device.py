"""OpenCV's V4L2 code over a device in user space (v4l2_device.c); skipped without a compiler."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.conftest import ROOT

SOURCE = Path(__file__).with_name("v4l2_device.c")
DEVICE = "/dev/video250"
OUTAGES = """
import json, sys
from pathlib import Path
from drivers.cameras import Webcam, WebcamSettings
from pipeline.errors import DriverError
device, folder = sys.argv[1], Path(sys.argv[2])
camera = Webcam(WebcamSettings(
    device=device, open_timeout_s=30, read_timeout_s=0.4, outage_s=60, backoff_s=(0.02, 0.05)
))
told = camera.open()
def lost(times):
    while camera.summary()["attempts"] < times:
        camera.read(0.05)
def back():
    while camera.read(0.05) is None:
        pass
for switch, times in (("silent", 2), ("gone", 4)):
    (folder / switch).touch()
    lost(times)
    (folder / switch).unlink()
    back()
(folder / "damaged").touch()
while camera.summary()["frames"]["damaged"] < 3:
    camera.read(0.5)
camera.close()
print(json.dumps({"size_px": told.size_px, "transport": told.transport, **camera.summary()}))
"""


MOSAICS = """
import json, sys
from drivers.cameras import Webcam, WebcamSettings
found = {}
for fourcc in ("RGGB", "RG10", "pRAA"):
    camera = Webcam(WebcamSettings(device=sys.argv[1], fourcc=fourcc, size_px=(640, 480)))
    told = camera.open()
    pixels = camera.read(30).pixels
    cell = pixels[2:4, 4:6].tolist() if pixels.ndim == 2 else []
    found[fourcc] = [told.pixel_format, told.transport, pixels.shape, cell]
    camera.close()
print(json.dumps(found))
"""


@pytest.fixture
def device(tmp_path: Path, short_path: Path) -> dict[str, str]:
    """The environment in which there is such a device, at `DEVICE`."""
    compiler = shutil.which("cc")
    if compiler is None or not Path("/usr/include/linux/videodev2.h").exists():
        pytest.skip("no C compiler or no headers of the kernel")
    library = short_path / "v4l2_device.so"  # LD_PRELOAD allows no blank in a path
    command = [compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(SOURCE), "-ldl"]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    for turn in range(2):
        small = np.random.default_rng(turn).integers(0, 256, (60, 80, 3), np.uint8)
        shown = cv2.resize(small, (1280, 720), interpolation=cv2.INTER_NEAREST)
        cv2.imwrite(str(tmp_path / f"{turn}.jpg"), shown)
    given = {"LD_PRELOAD": str(library), "FAKE_VIDEO": DEVICE, "FAKE_FOLDER": str(tmp_path)}
    return {**os.environ, **given}


def run(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120
    )


@pytest.mark.slow
def test_what_holds_on_a_device_on_the_desk_holds_here(device: dict[str, str]) -> None:
    tests = ["tests/drivers/cameras/test_webcam.py", "-m", "hardware", "-p", "no:cacheprovider"]
    done = run(device, "-m", "pytest", *tests, f"--camera={DEVICE}")

    assert done.returncode == 0, done.stdout
    assert "skipped" not in done.stdout


def test_a_mosaic_is_delivered_as_the_device_sends_it(device: dict[str, str]) -> None:
    done = run(device, "-c", MOSAICS, DEVICE)

    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    for fourcc, name, scale in (("RGGB", "bayer_rggb8", 1), ("RG10", "bayer_rggb10", 4)):
        pixel_format, transport, shape, ((red, green), (other, blue)) = told[fourcc]
        assert (pixel_format, transport, shape) == (name, f"V4L2, {fourcc}", [480, 640])
        assert [red - blue, green - blue] == [150 * scale, 50 * scale]
        assert other == green
        assert blue // scale in range(50, 100)
    assert told["pRAA"][:2] == ["bgr8", "V4L2, YUYV"]  # not offered: the device chooses


def test_a_device_that_is_silent_unplugged_or_damaged_is_read_on(
    device: dict[str, str], tmp_path: Path
) -> None:
    done = run(device, "-c", OUTAGES, DEVICE, str(tmp_path))

    assert done.returncode == 0, done.stderr
    told: dict[str, Any] = json.loads(done.stdout)
    assert (told["size_px"], told["transport"]) == ([1280, 720], "V4L2, MJPG")
    assert told["asked"] == {"fourcc": "MJPG", "size_px": [1920, 1080]}
    assert (told["device"], told["reconnects"]) == ("Fake Camera", 2)
    assert [outage["reason"] for outage in told["outages"]["newest"]] == [
        "it is open but sends no frame",
        "the device does not deliver any more",
    ]
    assert told["outages"]["newest"][1]["attempts"] >= 2
