"""Lay small pictures over a window, also over one that is averaged: patch and place -> pixels."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.readout import average

Image = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """A patch at its place in the picture."""

    patch: Image  # (h, w, 4) premultiplied RGBA, or (h, w) how much is taken away: a shadow
    left: int
    top: int

    def paste(self, out: Image, left: int, top: int, reduce: int) -> None:
        """Lay it over `out` (h, w, 3), the window at (left, top) averaged over `reduce` squared.

        Without reduction each pixel depends on its place alone, not on the window.
        """
        x, y = self.left - left, self.top - top
        high, wide = self.patch.shape[:2]
        if not (-wide < x < out.shape[1] * reduce and -high < y < out.shape[0] * reduce):
            return
        patch = self.patch if reduce == 1 else _means(self.patch, x % reduce, y % reduce, reduce)
        x, y = x // reduce, y // reduce
        x0, y0 = max(x, 0), max(y, 0)
        x1, y1 = min(x + patch.shape[1], out.shape[1]), min(y + patch.shape[0], out.shape[0])
        part, place = patch[y0 - y : y1 - y, x0 - x : x1 - x], out[y0:y1, x0:x1]
        alpha = part if part.ndim == 2 else cv2.extractChannel(part, 3)
        rest = cv2.merge([cv2.bitwise_not(alpha)] * 3)
        cv2.multiply(place, rest, dst=place, scale=1 / 255)
        if part.ndim == 3:
            cv2.add(place, cv2.cvtColor(part, cv2.COLOR_RGBA2RGB), dst=place)


def _means(patch: Image, right: int, down: int, reduce: int) -> Image:
    """Return the patch's means over cells, the first of which begin so far left and above it."""
    high, wide = (
        -(-(side + before) // reduce) * reduce
        for side, before in zip(patch.shape[:2], (down, right), strict=True)
    )
    roomy = np.zeros((high, wide, *patch.shape[2:]), np.uint8)
    roomy[down:, right:][: patch.shape[0], : patch.shape[1]] = patch
    made = np.empty((high // reduce, wide // reduce, *patch.shape[2:]), np.uint8)
    average(roomy, made)
    return made
