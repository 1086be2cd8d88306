"""Shrink a mosaic without demosaicing it: raw rows in, the mean of each colour in each cell out.

The four samples of a 2x2 cell of the mosaic become one superpixel with four channels, whose area is
averaged over the cells of the output. A strip of rows at a time is read, so that neither a
full-size RGB picture nor an unpacked copy of the whole mosaic is made where whole superpixels can
be averaged on the way.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.samples import STRIP, Samples
from pipeline.pixel_formats import PixelFormat

LEAST_BLOCKS = 4
EIGHT_BIT_UNIT = 256  # samples of 8 bit are averaged as 16 bit, which keeps fractions


def can_bin(size_px: tuple[int, int], out_px: tuple[int, int]) -> bool:
    """Whether every cell of the output holds at least one superpixel, and nothing is left over.

    >>> can_bin((2040, 1148), (480, 270)), can_bin((641, 480), (160, 120))
    (True, False)
    """
    return all(side % 2 == 0 and side >= 2 * out for side, out in zip(size_px, out_px, strict=True))


def unit_of(form: PixelFormat) -> int:
    """What one digital number of the format is in `Binning`'s means."""
    return EIGHT_BIT_UNIT if form.bits == 8 else 1


class Binning:
    """Shrinks mosaics of one format and size to one size, with memory for it."""

    def __init__(
        self, form: PixelFormat, size_px: tuple[int, int], out_px: tuple[int, int]
    ) -> None:
        self._samples = Samples(form, size_px[0])
        self._deep = form.bits > 8
        self._out_px = out_px
        width, height = size_px[0] // 2, size_px[1] // 2
        self._step = step = _whole_step((width, height), out_px)
        self._bytes = np.empty((0 if self._deep else STRIP // 2, width, 2), np.uint16)
        self._cells = np.empty((STRIP // 2, width, 4), np.uint16)
        self._small = np.empty((height // step, width // step, 4), np.uint16)
        self._means = np.empty((out_px[1], out_px[0], 4), np.uint16)

    def __call__(self, pixels: NDArray[Any]) -> NDArray[np.uint16]:
        """Means (h, w, 4) of the samples at (0, 0), (0, 1), (1, 0), (1, 1) of the mosaic's cells.

        In units of `unit_of`; valid until the next call.
        """
        for top in range(0, len(pixels), STRIP):
            samples = self._samples(pixels[top : top + STRIP])
            count = len(samples) // 2
            first = top // 2 // self._step
            rows = self._small[first : first + count // self._step]
            if self._step == 1:
                self._superpixels(samples, rows)
                continue
            cells = self._cells[:count]
            self._superpixels(samples, cells)
            cv2.resize(cells, rows.shape[1::-1], dst=rows, interpolation=cv2.INTER_AREA)
        cv2.resize(self._small, self._out_px, dst=self._means, interpolation=cv2.INTER_AREA)
        return self._means

    def _superpixels(self, samples: NDArray[Any], out: NDArray[np.uint16]) -> None:
        """Samples (2 n, 2 m) -> (n, m, 4); the two of a row move as one number."""
        if self._deep:
            pairs = samples.view(np.int32)
            cv2.merge([pairs[0::2], pairs[1::2]], out.view(np.int32))
            return
        pairs = samples.view(np.uint16)
        merged = self._bytes[: len(out)]
        cv2.merge([pairs[0::2], pairs[1::2]], merged)
        np.multiply(merged.view(np.uint8), np.uint16(EIGHT_BIT_UNIT), out=out)


def _whole_step(size: tuple[int, int], out: tuple[int, int]) -> int:
    """How many superpixels a side are averaged first: 1, 2, 4 or 8.

    The edge of a cell that cuts such a block softens by its width, so at least `LEAST_BLOCKS` a
    side remain in each cell; blocks must fit the picture and the strip.
    """
    step = 1
    while step < 8 and all(
        side % (step * 2) == 0 and side // (step * 2) >= LEAST_BLOCKS * short
        for side, short in zip(size, out, strict=True)
    ):
        step *= 2
    return step
