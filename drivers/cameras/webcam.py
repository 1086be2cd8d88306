"""A webcam: a V4L2 device of this host in, its newest frames out."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from drivers.camera import Expected, Negotiated, Picture
from drivers.cameras import opencv
from drivers.cameras.link import LinkSettings
from drivers.cameras.opencv_camera import OpenCvCamera
from drivers.cameras.v4l2 import link_stream, look_at, path_of
from pipeline.errors import DriverError, SettingsError
from pipeline.forecast import LinkUse

MOST_DEVICES, SIDE_PX = 255, 32_768


@dataclass(frozen=True, kw_only=True)
class WebcamSettings(LinkSettings):
    """The device and what is asked of it; it may choose another size, rate or format."""

    device: int | str = 0  # number N of /dev/videoN, or a path, e.g. below /dev/v4l/by-id
    size_px: tuple[int, int] = (1920, 1080)  # width, height; 0, 0: OpenCV's choice, 640x480
    rate_hz: float = 30.0  # 0: the device's own
    fourcc: str = "MJPG"  # a USB 2 link has no room for more than 640x480 uncompressed; "": any

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.device, int) and not 0 <= self.device <= MOST_DEVICES:
            raise SettingsError(f"device: expected 0 to {MOST_DEVICES}, got {self.device}")
        if isinstance(self.device, str) and not self.device.startswith("/"):
            raise SettingsError(f"device: expected a number or a path, got {self.device!r}")
        if self.size_px != (0, 0) and not all(1 <= side <= SIDE_PX for side in self.size_px):
            raise SettingsError(f"size_px: expected sides of 1 to {SIDE_PX}, got {self.size_px}")
        if not 0 <= self.rate_hz <= opencv.MOST_HZ:
            raise SettingsError(f"rate_hz: expected 0 to {opencv.MOST_HZ:g}, got {self.rate_hz:g}")
        if not re.fullmatch(r"([ -~]{4})?", self.fourcc):
            raise SettingsError(
                f"fourcc: expected four letters, e.g. MJPG or YUYV, got {self.fourcc!r}"
            )


class Webcam:
    """A `Camera` over V4L2 by OpenCV. Reopened under its path after it was unplugged."""

    settings_type: ClassVar[type[Any]] = WebcamSettings

    def __init__(self, settings: WebcamSettings) -> None:
        self._settings = settings
        self.source = path_of(settings.device)
        self._device = ""  # its name
        self._camera = OpenCvCamera(self._connect, settings, name=self.source)

    @property
    def absent_until_s(self) -> float:
        """Until when it looks for a lost camera, in `time.monotonic()`; 0: none is lost."""
        return self._camera.absent_until_s

    def open(self) -> Negotiated:
        """Acquire the device; raises `DriverError` with the reason in one sentence."""
        return self._camera.open()

    def expected(self) -> Expected | None:
        """What was asked of it or, once it was open, what it chose."""
        wanted, told, fourcc = self._settings, self._camera.negotiated, self._camera.told.fourcc
        if told is None:
            if wanted.size_px == (0, 0):
                return None
            fourcc = wanted.fourcc
            told = Negotiated(
                size_px=wanted.size_px, rate_hz=wanted.rate_hz, pixel_format="bgr8",
                transport=f"V4L2, {fourcc}",
            )  # fmt: skip
        crossing = link_stream(fourcc, told.size_px, told.rate_hz)
        return Expected(negotiated=told, link=LinkUse(streams=(crossing,)))

    def read(self, timeout_s: float) -> Picture | None:
        """The newest frame that was not read yet."""
        return self._camera.read(timeout_s)

    def close(self) -> None:
        """Release the device."""
        self._camera.close()

    def summary(self) -> Mapping[str, Any]:
        """The device, what was asked of it and what it chose, and what happened."""
        wanted, found = self._settings, self._camera.summary()
        asked = {"fourcc": wanted.fourcc, "size_px": list(wanted.size_px)}
        return {
            **found,
            "device": self._device,
            "asked": asked,
            "rate_hz": {"asked": wanted.rate_hz, **found["rate_hz"]},
        }

    def _connect(self) -> opencv.OpenCvConnection:
        wanted = self._settings
        self._device = look_at(self.source)
        connection = opencv.connect(
            self.source,
            opencv.V4L2,
            name=self.source,
            parameters={},
            read_timeout_s=wanted.read_timeout_s,
        )
        if connection is None:
            raise DriverError(
                f"{self.source}: {self._device} offers no pixel format that OpenCV can read"
            )
        connection.ask(size_px=wanted.size_px, rate_hz=wanted.rate_hz, fourcc=wanted.fourcc)
        return connection
