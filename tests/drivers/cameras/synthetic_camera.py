"""A camera without a device: numbered pictures of any format, as fast as they are read."""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import Negotiated, Picture
from pipeline.errors import DriverError
from pipeline.pixel_formats import FORMATS
from tests.drivers.numbered import picture


@dataclass(frozen=True, kw_only=True)
class SyntheticCameraSettings:
    size_px: tuple[int, int] = (320, 192)
    pixel_format: str = "rgb8"
    rate_hz: float = 0.0  # of its stamps; 0: the real time
    skipped: int = 0  # told with every picture
    frames: int = 0  # then it is silent; 0: never
    grows_at: int = -1  # from this frame on, its pictures are larger
    unreachable: bool = False


class SyntheticCamera:
    settings_type: ClassVar[type[Any]] = SyntheticCameraSettings
    opened = 0  # and not closed, of all

    def __init__(self, settings: SyntheticCameraSettings) -> None:
        self.settings = settings
        self.made = 0
        self._closed = threading.Event()
        self._open = False

    def open(self) -> Negotiated:
        if self.settings.unreachable:
            raise DriverError("synthetic camera: it is not there")
        SyntheticCamera.opened += 1
        self._open = True
        self._closed.clear()
        return Negotiated(
            size_px=self.settings.size_px,
            rate_hz=self.settings.rate_hz,
            pixel_format=self.settings.pixel_format,
            transport="memory",
        )

    def read(self, timeout_s: float) -> Picture | None:
        wanted = self.settings
        if wanted.frames and self.made >= wanted.frames:
            self._closed.wait(timeout_s)
            return None
        size_px = wanted.size_px
        if 0 <= wanted.grows_at <= self.made:
            size_px = (size_px[0] * 2, size_px[1] * 2)
        shown = as_format(picture(self.made, size_px), wanted.pixel_format)
        stamp_ns = time.monotonic_ns()
        if wanted.rate_hz:
            stamp_ns = round((self.made + 1) * (1 + wanted.skipped) * 1e9 / wanted.rate_hz)
        self.made += 1
        return Picture(pixels=shown, stamp_ns=stamp_ns, skipped=wanted.skipped)

    def close(self) -> None:
        SyntheticCamera.opened -= self._open
        self._open = False
        self._closed.set()

    def summary(self) -> Mapping[str, Any]:
        return {"made": self.made}


def as_format(rgb: NDArray[np.uint8], pixel_format: str) -> NDArray[Any]:
    """An RGB picture (h, w, 3) as a camera of this format would deliver it."""
    if pixel_format == "rgb8":
        return rgb
    if pixel_format == "bgr8":
        return np.ascontiguousarray(rgb[..., ::-1])
    if pixel_format.startswith("grey"):
        found = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
    else:
        found = mosaic(rgb, pixel_format.removeprefix("bayer_")[:4])
    lower = FORMATS[pixel_format].bits - 8
    return found if not lower else found.astype(np.uint16) << lower | 0x5A % (1 << lower)


def mosaic(rgb: NDArray[np.uint8], order: str) -> NDArray[np.uint8]:
    """One colour of each pixel: `order` names those of the cell's rows."""
    found = np.empty(rgb.shape[:2], np.uint8)
    for place, colour in enumerate(order):
        row, column = divmod(place, 2)
        found[row::2, column::2] = rgb[row::2, column::2, "rgb".index(colour)]
    return found
