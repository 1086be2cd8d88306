"""What webcams and network streams share as cameras: a way to connect in, newest frames out."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera import Negotiated, Picture
from drivers.cameras.link import LinkSettings
from drivers.cameras.newest import NewestFrame
from drivers.cameras.opencv import OpenCvConnection, Told
from pipeline.errors import DriverError


class OpenCvCamera:
    """`open read* close` over the connections that `connect` makes."""

    def __init__(
        self, connect: Callable[[], OpenCvConnection], limits: LinkSettings, *, name: str
    ) -> None:
        self._connect, self._limits, self._name = connect, limits, name
        self._frames: NewestFrame | None = None
        self._size_px = (0, 0)
        self.told = Told()  # by the newest connection
        self.negotiated: Negotiated | None = None  # since the first `open`

    @property
    def absent_until_s(self) -> float:
        """Until when it looks for a lost camera, in `time.monotonic()`; 0: none is lost."""
        return self._frames.absent_until_s if self._frames else 0.0

    def open(self) -> Negotiated:
        """Acquire the camera and wait for its first frame, whose size and format count."""
        self._frames = NewestFrame(self._connected, self._limits, name=self._name)
        pixels = self._frames.open()
        self._size_px = (pixels.shape[1], pixels.shape[0])
        told = self.told
        self.negotiated = Negotiated(
            size_px=self._size_px,
            rate_hz=told.rate_hz,
            pixel_format=self._format_of(pixels),
            transport=", ".join(filter(None, (told.backend, told.fourcc))),
        )
        return self.negotiated

    def read(self, timeout_s: float) -> Picture | None:
        """The newest frame that was not read yet; None: none in time, or closed."""
        if self._frames is None:
            raise DriverError(f"{self._name}: read needs open before it")
        return self._frames.read(timeout_s)

    def close(self) -> None:
        """Release the device; safe after any outcome."""
        if self._frames is not None:
            self._frames.close()

    def summary(self) -> dict[str, Any]:
        """What was negotiated, and what happened on the link."""
        told, history = self.told, self._frames.history if self._frames else None
        achieved_hz = round(history.rate_hz, 3) if history else 0.0
        return {
            "name": self._name,
            "backend": told.backend,
            "fourcc": told.fourcc,
            "size_px": list(self._size_px),
            "rate_hz": {"told": round(told.rate_hz, 3), "achieved": achieved_hz},
            **(history.summary() if history else {}),
        }

    def _connected(self) -> OpenCvConnection:
        connection = self._connect()
        self.told = connection.told()
        return connection

    def _format_of(self, pixels: NDArray[Any]) -> str:
        if self.told.pixel_format:
            return self.told.pixel_format
        if pixels.ndim == 3 and pixels.shape[2] == 3 and pixels.dtype == np.uint8:
            return "bgr8"
        if pixels.ndim == 2 and pixels.dtype in (np.uint8, np.uint16):
            return "grey8" if pixels.dtype == np.uint8 else "grey16"
        got = f"{pixels.dtype} of {'x'.join(str(side) for side in pixels.shape)}"
        raise DriverError(f"{self._name}: expected colour or grey pixels, got {got}")
