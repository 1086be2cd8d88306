"""Bayer raw as a colour sensor delivers it: RGB pixels in, an RGGB mosaic out."""

import numpy as np
from numpy.typing import NDArray


def to_rggb(image: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Keep one colour of each pixel of an (h, w, 3) RGB image: red at (0, 0), blue at (1, 1).

    `out` is (h, w). The phase is that of the image's corner: a window must start at even pixels
    to show the mosaic of the sensor it was cut from.

    >>> mosaic = np.empty((2, 2), np.uint8)
    >>> to_rggb(np.full((2, 2, 3), (1, 2, 3), np.uint8), mosaic)
    >>> mosaic.tolist()
    [[1, 2], [2, 3]]
    """
    out[0::2, 0::2] = image[0::2, 0::2, 0]
    out[0::2, 1::2] = image[0::2, 1::2, 1]
    out[1::2, 0::2] = image[1::2, 0::2, 1]
    out[1::2, 1::2] = image[1::2, 1::2, 2]
