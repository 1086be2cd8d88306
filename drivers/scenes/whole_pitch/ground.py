"""What never moves, as windows: drawn once at a fraction of the resolution, enlarged where read.

The canvas has at most `MOST_PX`, whatever the picture's size, and each of its pixels stands for
`step` x `step` of the picture. What a pixel gets does not depend on the window that shows it.
"""

from collections import OrderedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.readout import average
from drivers.scenes.soccer.camera import View
from drivers.scenes.soccer.pitch import Canvas, Turf

Image = NDArray[np.uint8]

MOST_PX = 10 << 20  # 30 MB
MOST_REDUCED = 32 << 20  # bytes of reduced copies of the field that are kept
STRIP_PX = 1 << 20  # of the picture that are enlarged at a time to be averaged
# enlarged at a time to be copied, so that they are still in the processor's cache
COPIED_PX, LEAST_ROWS = 1 << 18, 32


class Ground:
    """A canvas for the pictures of a still view; `canvas` is to be painted before it is read."""

    def __init__(self, view: View, turf: Turf) -> None:
        self._size_px = view.size_px
        self._step = step = step_for(view.size_px)
        # one more pixel on each side, as enlarging looks at neighbours
        width, height = (-(-side // step) + 2 for side in view.size_px)
        middle = np.array(view.size_px) / 2 + step
        origin = np.array(view.aim) - middle / view.radius_px
        self.canvas = Canvas(
            image=np.empty((height, width, 3), np.uint8),
            origin=(float(origin[0]), float(origin[1])),
            radius_px=view.radius_px / step,
            grass=turf.colour,
        )
        self._scratch = np.empty(0, np.uint8)
        self._reduced: OrderedDict[int, Image] = OrderedDict()

    @property
    def nbytes(self) -> int:
        """Bytes of the canvas, its reduced copies and the memory to enlarge it."""
        reduced = sum(made.nbytes for made in self._reduced.values())
        return self.canvas.image.nbytes + self._scratch.nbytes + reduced

    def read(self, left: int, top: int, reduce: int, out: Image) -> None:
        """Fill `out` (h, w, 3) with the window at (left, top), averaged over `reduce` squared."""
        if reduce == 1:
            rows = max(LEAST_ROWS, COPIED_PX // out.shape[1])
            for first in range(0, len(out), rows):
                part = out[first : first + rows]
                part[:] = self._enlarged(left, top + first, part.shape[1], len(part))
            return
        copy = self._copy(reduce) if not (left % reduce or top % reduce) else None
        if copy is None:
            self._average(left, top, reduce, out)
            return
        row, column = top // reduce, left // reduce
        out[:] = copy[row : row + out.shape[0], column : column + out.shape[1]]

    def _copy(self, reduce: int) -> Image | None:
        """Return the whole field, reduced; None where it is too large to be kept."""
        if reduce not in self._reduced:
            width, height = (side // reduce for side in self._size_px)
            if width * height * 3 > MOST_REDUCED or not width or not height:
                return None
            made = np.empty((height, width, 3), np.uint8)
            self._average(0, 0, reduce, made)
            self._reduced[reduce] = made
            while sum(each.nbytes for each in self._reduced.values()) > MOST_REDUCED:
                self._reduced.popitem(last=False)
        self._reduced.move_to_end(reduce)
        return self._reduced[reduce]

    def _average(self, left: int, top: int, reduce: int, out: Image) -> None:
        width = out.shape[1] * reduce
        rows = max(1, STRIP_PX // (width * reduce))
        for first in range(0, len(out), rows):
            part = out[first : first + rows]
            high = len(part) * reduce
            average(self._enlarged(left, top + first * reduce, width, high), part)

    def _enlarged(self, left: int, top: int, width: int, height: int) -> Image:
        """Return a window at full resolution, valid until the next call."""
        step, image = self._step, self.canvas.image
        if step == 1:
            return image[top + 1 : top + 1 + height, left + 1 : left + 1 + width]
        # the canvas pixels that show the window, and one more on each side
        column, row = left // step, top // step
        columns = (left + width - 1) // step - column + 3
        rows = (top + height - 1) // step - row + 3
        size = columns * step, rows * step
        needed = size[0] * size[1] * 3
        if self._scratch.size < needed:
            self._scratch = np.empty(needed, np.uint8)
        made = self._scratch[:needed].reshape(size[1], size[0], 3)
        cv2.resize(
            image[row : row + rows, column : column + columns],
            size,
            dst=made,
            interpolation=cv2.INTER_LINEAR,
        )
        x, y = left - (column - 1) * step, top - (row - 1) * step
        return made[y : y + height, x : x + width]


def step_for(size_px: tuple[int, int]) -> int:
    """Return how many pixels of a picture a pixel of its canvas stands for, along each side.

    >>> step_for((1920, 1080)), step_for((7680, 4320)), step_for((16320, 9184))
    (1, 2, 4)
    """
    step = 1
    while (size_px[0] // step) * (size_px[1] // step) > MOST_PX:
        step += 1
    return step
