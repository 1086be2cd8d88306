"""Prepare frames for networks: Frame -> Frame, 8-bit RGB, at most `width_px` wide."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.contract import Input, Operator
from pipeline.errors import MessageError, SettingsError
from pipeline.messages import Frame

FORMATS = ("rgb8", "grey8", "bayer_rggb8", "bayer_rggb16")


@dataclass(frozen=True, kw_only=True)
class DownsampleSettings:
    """What a graph may set."""

    width_px: int = 0  # 0: keep the size

    def __post_init__(self) -> None:
        if self.width_px < 0:
            raise SettingsError(f"width_px: must be at least 0, got {self.width_px}")


class Downsample(Operator[DownsampleSettings, Frame]):
    """Demosaic, shrink by area, never enlarge; keep header, window and status.

    A frame that already fits passes unchanged, and so does an empty picture (no ROI).
    """

    frame = Input(Frame, keep="latest")

    def open(self) -> None:
        """Allocate nothing yet: the size is known with the first frame."""
        self._scratch: dict[str, NDArray[Any]] = {}

    def on_frame(self, frame: Frame) -> Frame:
        """Return a frame for each frame."""
        if frame.pixel_format not in FORMATS:
            raise MessageError(
                f"frame: expected pixels as {', '.join(FORMATS)}, got {frame.pixel_format}"
            )
        height, width = fitted(frame.pixels.shape[:2], self.settings.width_px)
        shrinks = (height, width) != frame.pixels.shape[:2]
        if frame.pixels.size == 0 or (frame.pixel_format == "rgb8" and not shrinks):
            return frame
        out = self.loan((height, width, 3), np.uint8)
        if frame.pixel_format == "rgb8":
            shrink(frame.pixels, out)
        elif shrinks:
            whole = self._memory("rgb", (*frame.pixels.shape[:2], 3))
            self._colour(frame, whole)
            shrink(whole, out)
        else:
            self._colour(frame, out)
        return replace(frame, pixels=out, pixel_format="rgb8")

    def _colour(self, frame: Frame, out: NDArray[np.uint8]) -> None:
        pixels = frame.pixels
        if frame.pixel_format == "grey8":
            cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB, out)
            return
        if frame.pixel_format == "bayer_rggb16":
            pixels = np.right_shift(
                pixels, 8, out=self._memory("mosaic", pixels.shape), casting="unsafe"
            )
        demosaic(pixels, out)

    def _memory(self, name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        found = self._scratch.get(name)
        if found is None or found.shape != shape:
            found = self._scratch[name] = np.empty(shape, np.uint8)
        return found


def fitted(size: tuple[int, ...], width_px: int) -> tuple[int, int]:
    """Return (height, width) after shrinking to at most `width_px`, aspect kept; 0: no limit.

    >>> fitted((1080, 1920), 480), fitted((270, 480), 640)
    ((270, 480), (270, 480))
    """
    height, width = size
    if not width_px or width <= width_px:
        return height, width
    return max(1, round(height * width_px / width)), width_px


def shrink(image: NDArray[Any], out: NDArray[np.uint8]) -> None:
    """Shrink an (h, w, 3) image into `out` by averaging areas."""
    cv2.resize(image, (out.shape[1], out.shape[0]), dst=out, interpolation=cv2.INTER_AREA)


def demosaic(mosaic: NDArray[Any], out: NDArray[np.uint8]) -> None:
    """Interpolate an RGGB mosaic (h, w) of 8 bit to RGB (h, w, 3), at least 3x3."""
    cv2.cvtColor(mosaic, cv2.COLOR_BayerRGGB2RGB, out)
