"""Rows of a frame as one number per sample: packed bytes -> uint16, anything else as it is.

PFNC's `p` formats are a little-endian stream of bits. Four samples fill 5 bytes (10 bit) or 6 bytes
(12 bit). Each such group is loaded as one 64-bit word and spread over four 16-bit lanes by shifts
and masks, which numpy does for several words at once; a strip of rows stays in the cache.
"""

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from pipeline.pixel_formats import PixelFormat

STRIP = 32  # rows handled at a time: even, so that every strip of a mosaic begins in phase
GROUP = 4  # samples of one word


class Samples:
    """Reads strips of at most `STRIP` rows from pictures of one format and width."""

    def __init__(self, form: PixelFormat, width_px: int) -> None:
        self._form, self._width_px = form, width_px
        if not form.packed:
            return
        groups, group_bytes = -(-width_px // GROUP), form.bits * GROUP // 8
        # the word of a row's last group reaches 8 - group_bytes past the row
        self._rows = np.zeros((STRIP, groups * group_bytes + 8), np.uint8)
        first = self._rows[:, :8].view(np.uint64)
        self._groups = as_strided(first, (STRIP, groups), (first.strides[0], group_bytes))
        self._words = np.empty((STRIP, groups), np.uint64)
        self._moved = np.empty((STRIP, groups), np.uint64)

    def __call__(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Samples (n, w) of n rows of `Frame.pixels`; unpacked ones are valid until the next call.

        >>> from pipeline.pixel_formats import FORMATS
        >>> packed = np.array([[0xFF, 0x03, 0x00, 0x00, 0x40]], np.uint8)
        >>> Samples(FORMATS["grey10p"], 4)(packed).tolist()
        [[1023, 0, 0, 256]]
        """
        if not self._form.packed:
            return rows
        count, bits = len(rows), self._form.bits
        self._rows[:count, : rows.shape[1]] = rows
        words, moved = self._words[:count], self._moved[:count]
        np.copyto(words, self._groups[:count])
        _part(words, moved, low=(1 << 2 * bits) - 1, by=32 - 2 * bits)  # two samples a half
        _part(words, moved, low=((1 << bits) - 1) * (1 + (1 << 32)), by=16 - bits)  # one a quarter
        samples: NDArray[np.uint16] = words.view(np.uint16)[:, : self._width_px]
        return samples


def _part(words: NDArray[np.uint64], moved: NDArray[np.uint64], *, low: int, by: int) -> None:
    """Keep the bits `low` of every word and move as many that follow them up by `by` more bits."""
    width = (low & 0xFFFFFFFF).bit_length()
    np.left_shift(words, np.uint64(by), out=moved)
    np.bitwise_and(moved, np.uint64(low << width + by), out=moved)
    np.bitwise_and(words, np.uint64(low), out=words)
    np.bitwise_or(words, moved, out=words)
