"""Packed samples bit by bit, slowly: what fast packing and unpacking are checked against."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.pixel_formats import PixelFormat


def numbers(pixels: NDArray[Any], form: PixelFormat) -> NDArray[np.int64]:
    """Samples (h, w) of the pixels of a frame."""
    if not form.packed:
        return pixels.astype(np.int64)
    bits = np.unpackbits(pixels, axis=1, bitorder="little")
    width = bits.shape[1] // form.bits
    parts = bits[:, : width * form.bits].reshape(len(pixels), width, form.bits)
    return parts.astype(np.int64) @ (1 << np.arange(form.bits))


def packed(samples: NDArray[np.integer[Any]], form: PixelFormat) -> NDArray[Any]:
    """Pixels of a frame with these samples (h, w)."""
    if not form.packed:
        return samples.astype(form.dtype)
    bits = (samples[..., None].astype(np.int64) >> np.arange(form.bits)) & 1
    return np.packbits(bits.astype(np.uint8).reshape(len(samples), -1), axis=1, bitorder="little")
