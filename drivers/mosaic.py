"""What a sensor with a colour filter array sends: RGB or samples in, pixels of a raw format out."""

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from pipeline.pixel_formats import PixelFormat

GROUP = 4  # samples packed at a time, in one 64-bit word
STRIP = 32  # rows packed at a time, so that they stay in the cache


def to_mosaic(image: NDArray[np.uint8], order: str, out: NDArray[np.uint8]) -> None:
    """Keep one colour of each pixel of an (h, w, 3) RGB image; `out` is (h, w).

    `order` is that of the image's own first pixel: a window of a sensor has another one where it
    starts at odd pixels (`PixelFormat.shifted`).

    >>> mosaic = np.empty((2, 2), np.uint8)
    >>> to_mosaic(np.full((2, 2, 3), (1, 2, 3), np.uint8), "grbg", mosaic)
    >>> mosaic.tolist()
    [[2, 1], [3, 2]]
    """
    for site, colour in enumerate(order):
        row, column = divmod(site, 2)
        out[row::2, column::2] = image[row::2, column::2, "rgb".index(colour)]


def write_samples(samples: NDArray[Any], form: PixelFormat, out: NDArray[Any]) -> None:
    """Write samples (h, w), no larger than `form.white`, as the format has them into `out`."""
    if not form.packed:
        np.copyto(out, samples, casting="unsafe")
        return
    for top in range(0, len(samples), STRIP):
        _pack(samples[top : top + STRIP], form.bits, out[top : top + STRIP])


def _pack(samples: NDArray[Any], bits: int, out: NDArray[np.uint8]) -> None:
    """Samples (n, w) as a stream of bits a row, least significant first (PFNC's `p`)."""
    count, width = samples.shape
    groups, group_bytes = -(-width // GROUP), bits * GROUP // 8
    lanes = np.zeros((count, groups * GROUP), np.uint16)
    lanes[:, :width] = samples
    words = lanes.view(np.uint64)
    _join(words, low=((1 << bits) - 1) * (1 + (1 << 32)), by=16 - bits)
    _join(words, low=(1 << 2 * bits) - 1, by=32 - 2 * bits)
    packed = np.empty((count, groups * group_bytes), np.uint8)
    # the first four bytes of every group, then the fifth or the fifth and sixth
    line = packed.strides[0], group_bytes
    as_strided(packed[:, :4].view(np.uint32), words.shape, line)[...] = words.view(np.uint32)[
        :, ::2
    ]
    rest = np.dtype(np.uint8 if group_bytes == 5 else np.uint16)
    as_strided(packed[:, 4:group_bytes].view(rest), words.shape, line)[...] = words >> np.uint64(32)
    out[...] = packed[:, : out.shape[1]]


def _join(words: NDArray[np.uint64], *, low: int, by: int) -> None:
    """Move what lies `by` bits above the bits `low` of every word down to them."""
    high = low << (low & 0xFFFFFFFF).bit_length()
    moved = np.right_shift(words, np.uint64(by))
    np.bitwise_and(moved, np.uint64(high), out=moved)
    np.bitwise_and(words, np.uint64(low), out=words)
    np.bitwise_or(words, moved, out=words)
