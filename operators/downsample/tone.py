"""From a sensor's numbers to 8 bit: black level, gain of each colour, gamma.

A sample becomes 255 * (gain * (sample - black) / (white - black)) ^ (1 / gamma), cut to 0..255.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.samples import STRIP
from operators.downsample.binning import unit_of
from pipeline.pixel_formats import PixelFormat

FULL = 255 * 256  # white on the linear scale of 16 bit that gamma starts from
Gains = tuple[float, float, float]  # red, green, blue


class Curve:
    """Gamma on the linear scale, as two tables of 256 entries: a fine one for the dark 16th.

    One table of 65536 entries costs five times as much: it is not looked up by vector instructions.
    The result is within one level of the exact value.
    """

    def __init__(self, gamma: float) -> None:
        self.linear = gamma == 1
        steps = np.arange(256)
        bright = 255 * (steps * 256 / FULL) ** (1 / gamma)
        bright[:16] = 0
        self._bright = np.rint(bright.clip(0, 255)).astype(np.uint8)
        self._dark = np.rint(255 * (steps * 16 / FULL) ** (1 / gamma)).astype(np.uint8)

    def __call__(self, linear: NDArray[np.uint16], out: NDArray[np.uint8]) -> None:
        """Linear values 0..`FULL` of any shape -> 8 bit; more is white."""
        if self.linear:
            cv2.convertScaleAbs(linear, out, 1 / 256)
            return
        dark = cv2.LUT(np.asarray(cv2.convertScaleAbs(linear, None, 1 / 16)), self._dark)
        cv2.LUT(np.asarray(cv2.convertScaleAbs(linear, None, 1 / 256)), self._bright, out)
        cv2.max(out, dark, out)


@dataclass(frozen=True, kw_only=True)
class Levels:
    """What makes a format's numbers light: `black` is dark, `white` is full."""

    black: int
    white: int
    gains: Gains

    def plain(self, form: PixelFormat) -> bool:
        """Whether samples of 8 bit are light already."""
        return form.bits == 8 and self == Levels(black=0, white=255, gains=(1.0, 1.0, 1.0))


class Tone:
    """Applies levels and curve to pictures of one format and width."""

    def __init__(self, form: PixelFormat, width_px: int, levels: Levels, curve: Curve) -> None:
        self._curve, self._levels = curve, levels
        self._reach = levels.white - levels.black
        self._form, self._width_px = form, width_px
        self._mix = _mix(form.order, levels.gains) if form.order else np.zeros((3, 4))
        self._unit = unit_of(form)

    @cached_property
    def _gains(self) -> NDArray[np.float32]:
        """The gain of each site of a strip: one multiplication for all colours."""
        gain = dict(zip("rgb", self._levels.gains, strict=True))
        cell = [gain[site] for site in self._form.order] or [1.0] * 4
        repeats = (STRIP // 2, -(-self._width_px // 2))
        tile = np.tile(np.array(cell, np.float32).reshape(2, 2), repeats)
        return np.ascontiguousarray(tile[:, : self._width_px])

    @cached_property
    def _scratch(self) -> tuple[NDArray[Any], NDArray[np.uint16]]:
        shape = (STRIP, self._width_px)
        own = np.uint16 if self._form.bits > 8 else np.uint8
        return np.empty(shape, own), np.empty(shape, np.uint16)

    def strip(self, samples: NDArray[Any], out: NDArray[np.uint8]) -> None:
        """Up to `STRIP` rows of samples (n, w), the first an even one, -> 8 bit (n, w)."""
        count = len(samples)
        above, linear = (memory[:count] for memory in self._scratch)
        if self._levels.black:
            black = samples.dtype.type(self._levels.black)
            np.maximum(samples, black, out=above)
            samples = np.subtract(above, black, out=above)
        gains = self._gains[:count]
        if self._curve.linear:
            cv2.multiply(samples, gains, out, 255 / self._reach, cv2.CV_8U)
            return
        cv2.multiply(samples, gains, linear, FULL / self._reach, cv2.CV_16U)
        self._curve(linear, out)

    def superpixels(self, means: NDArray[np.uint16], out: NDArray[np.uint8]) -> None:
        """Means (h, w, 4) of a binned mosaic -> RGB (h, w, 3)."""
        scale = FULL / (self._reach * self._unit)
        black = self._levels.black * self._unit
        matrix = np.empty((3, 5))
        matrix[:, :4] = self._mix * scale
        matrix[:, 4] = -black * matrix[:, :4].sum(1)
        self._curve(np.asarray(cv2.transform(means, matrix), np.uint16), out)


def _mix(order: str, gains: Gains) -> NDArray[np.float64]:
    """Weights (3, 4) of a superpixel's samples in red, green and blue."""
    shares = np.array([[float(site == colour) for site in order] for colour in "rgb"])
    shares *= np.array(gains)[:, None] / shares.sum(1, keepdims=True)
    return shares
