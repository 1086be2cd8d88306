"""Eq. 1 on one picture: a full-resolution RGB picture in, context D(v) and ROI C(v) out.

D averages areas, C crops; both write into the memory they are given. A Bayer mosaic and noise are
added on the way when asked for.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.commands import Window
from drivers.readout import average

OFFSETS = 1 << 20  # places in the noise table where a picture's noise may begin


class Readout:
    """Reads regions of at most `most_px` pixels, with scratch memory for what needs a detour."""

    def __init__(self, *, mosaic: bool, noise: float, seed: int, most_px: int) -> None:
        self.mosaic, self._noise, self._seed = mosaic, noise, seed
        self._scratch: dict[int, NDArray[np.uint8]] = {}
        if noise:  # now, since the first exposure cannot wait for it
            self._table = noise_table(noise, most_px * (1 if mosaic else 3) + OFFSETS, seed)

    @property
    def pixel_format(self) -> str:
        """How the frames name what they carry."""
        return "bayer_rggb8" if self.mosaic else "rgb8"

    def shape(self, size_px: tuple[int, int]) -> tuple[int, ...]:
        """Shape of the array that a picture of this width and height fills."""
        width, height = size_px
        return (height, width) if self.mosaic else (height, width, 3)

    def read(
        self,
        picture: NDArray[np.uint8],
        window: Window,
        out: NDArray[np.uint8],
        *,
        seq: int,
        port: int,
    ) -> None:
        """Fill `out` with `window` of the picture; `port` tells the two streams' noise apart."""
        left, top, right, bottom = window
        region = picture[top:bottom, left:right]
        height, width = out.shape[:2]
        if region.shape[:2] != (height, width):
            target = self._scratch_of(port, (height, width, 3)) if self.mosaic else out
            average(region, target)
            region = target
        if self.mosaic:
            to_rggb(region, out)
        elif region is not out:
            np.copyto(out, region)
        if self._noise:
            self._add_noise(out, seq, port)

    def _scratch_of(self, port: int, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        found = self._scratch.get(port)
        if found is None or found.shape != shape:
            found = self._scratch[port] = np.empty(shape, np.uint8)
        return found

    def _add_noise(self, out: NDArray[np.uint8], seq: int, port: int) -> None:
        start = int(np.random.default_rng((self._seed, seq, port)).integers(OFFSETS))
        cv2.add(out, self._table[start : start + out.size].reshape(out.shape), out, None, cv2.CV_8U)


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


def noise_table(deviation: float, size: int, seed: int) -> NDArray[np.int16]:
    """Normal noise (size,) in whole digital numbers; each picture shows another stretch of it.

    Drawing every picture anew costs ten times as much as all the rest of the read-out.
    """
    drawn = np.random.default_rng(seed).standard_normal(size, np.float32)
    return np.asarray(np.rint(np.clip(drawn * deviation, -255, 255)), np.int16)
