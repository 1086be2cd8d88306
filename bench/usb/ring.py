"""A world of raw pictures made beforehand: a virtual board sends them without rendering anything.

The soccer scene is drawn at the size of the context. The field is the same picture enlarged, as a
mosaic of the whole sensor, so that a window of it shows what the context shows there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.simulated.sources import open_scene
from drivers.usb.frame_header import Stream, Window
from drivers.virtual_board.world import World
from pipeline.errors import DriverError
from pipeline.pixel_formats import PixelFormat


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """Both mosaics of one exposure."""

    context: NDArray[Any]  # (h, w) uint8 or uint16
    field: NDArray[Any]  # (h, w), the whole sensor


def prepared(
    form: PixelFormat, size_px: tuple[int, int], context_px: tuple[int, int], *, count: int,
    seed: int,
) -> list[Prepared]:  # fmt: skip
    """Return the mosaics of `count` successive pictures of the soccer scene."""
    if not form.order or form.packed:
        raise DriverError(f"ring: expected a mosaic that is not packed, got {form.name}")
    scene = open_scene(
        "soccer", size_px=context_px, rate_hz=30.0, seed=seed, length=count, options={}
    )
    try:
        pictures = (scene.picture(index) for index in range(count))
        return [
            Prepared(context=_mosaic(p, form, context_px), field=_mosaic(p, form, size_px))
            for p in pictures
        ]
    finally:
        scene.close()


class RingWorld(World):
    """Sends prepared pictures forwards and backwards, for ever."""

    def __init__(self, form: PixelFormat, ring: Sequence[Prepared]) -> None:
        self.length = None
        self._form, self._ring = form, ring

    def code(self, window: Window, size_px: tuple[int, int]) -> int:
        """PFNC code of a frame; the context has the sensor's own order."""
        return self._form.shifted(window[0], window[1]).code

    def payload(
        self, index: int, window: Window, size_px: tuple[int, int], nbytes: int, port: int
    ) -> NDArray[np.uint8]:
        """Return the bytes of a frame as they lie in the prepared pictures.

        Raises `DriverError` for a window that is not read pixel by pixel.
        """
        found = self._ring[turned(index, len(self._ring))]
        if port == Stream.CONTEXT:
            return found.context.reshape(-1).view(np.uint8)
        (left, top, right, bottom), wide = window, found.field.itemsize
        if (right - left, bottom - top) != size_px:
            raise DriverError(f"ring: expected a window of {size_px}, got {window}")
        return found.field.view(np.uint8)[top:bottom, left * wide : right * wide]

    def close(self) -> None:
        """Nothing is held open."""


class BlankWorld(World):
    """Sends black pictures, which take no time to prepare."""

    def __init__(self, form: PixelFormat) -> None:
        self.length = None
        self._form = form
        self._black: dict[int, NDArray[np.uint8]] = {}

    def code(self, window: Window, size_px: tuple[int, int]) -> int:
        """PFNC code of a frame."""
        return self._form.shifted(window[0], window[1]).code

    def payload(
        self, index: int, window: Window, size_px: tuple[int, int], nbytes: int, port: int
    ) -> NDArray[np.uint8]:
        """Return the same bytes again."""
        return self._black.setdefault(nbytes, np.zeros(nbytes, np.uint8))

    def close(self) -> None:
        """Nothing is held open."""


def turned(index: int, count: int) -> int:
    """Return the place in a ring that is passed forwards and backwards.

    >>> [turned(index, 3) for index in range(7)], turned(5, 1)
    ([0, 1, 2, 1, 0, 1, 2], 0)
    """
    around = max(1, 2 * count - 2)
    return min(index % around, around - index % around) if count > 1 else 0


def _mosaic(
    picture: NDArray[np.uint8], form: PixelFormat, size_px: tuple[int, int]
) -> NDArray[Any]:
    """Return the mosaic (h, w) of an RGB picture enlarged to that size, full range."""
    width, height = size_px
    out = np.empty((height, width), form.dtype)
    for site, colour in enumerate(form.order):
        row, column = divmod(site, 2)
        plane = np.ascontiguousarray(picture[..., "rgb".index(colour)])
        found = cv2.resize(plane, (width // 2, height // 2), interpolation=cv2.INTER_LINEAR)
        if form.bits > 8:
            found = np.multiply(found, form.white / 255, dtype=np.float32)
        out[row::2, column::2] = found
    return out
