"""What every frame adds, by place: the sensor's noise and drops of rain in the air.

Both are in one picture, laid like tiles from a new place in every frame. What a pixel gets depends
on where it is and on the frame, not on the window that shows it.
"""

from collections import OrderedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.readout import average

Image = NDArray[np.uint8]

SIDE_PX = 960  # of the tile: it has many divisors, so that most reductions divide it
STEP_PX = 16  # a frame begins at multiples of it
MOST_KEPT = 64  # reduced tiles, each a quarter of the tile or less
SOFT_PX = 0.6  # of the noise
DROP_PX = (14, 60)  # length of a drop's trace in a picture 7680 wide


class Grain:
    """Noise of a standard deviation of `deviation` grey levels, and `drops` traces of drops.

    `larger` is the picture's scale relative to one of 7680 wide.
    """

    def __init__(self, seed: int, deviation: float, drops: int, larger: float = 1.0) -> None:
        self._seed = seed
        rng = np.random.default_rng([seed, 41])
        tile = _noise(rng, deviation)
        for _ in range(drops):
            _drop(tile, rng, larger)
        self._tile = tile
        self._reduced: OrderedDict[tuple[int, int, int], Image] = OrderedDict()

    @property
    def nbytes(self) -> int:
        """Bytes of the tile and its reduced copies."""
        return self._tile.nbytes + sum(tile.nbytes for tile in self._reduced.values())

    @staticmethod
    def divides(reduce: int) -> bool:
        """Whether a window may be reduced so without being made at full resolution."""
        return SIDE_PX % reduce == 0

    def add(self, index: int, left: int, top: int, reduce: int, out: Image) -> None:
        """Add it to `out` (h, w, 3), a window of frame `index` that begins at (left, top)."""
        rng = np.random.default_rng([self._seed, 42, index])
        x, y = (rng.integers(0, SIDE_PX // STEP_PX, 2) * STEP_PX + (left, top)) % SIDE_PX
        tile = self._means(int(x) % reduce, int(y) % reduce, reduce)
        side, x0, y0 = len(tile), int(x) // reduce, int(y) // reduce
        row, v = 0, y0
        while row < out.shape[0]:
            high = min(side - v, out.shape[0] - row)
            column, u = 0, x0
            while column < out.shape[1]:
                wide = min(side - u, out.shape[1] - column)
                part = out[row : row + high, column : column + wide]
                cv2.add(part, tile[v : v + high, u : u + wide], dst=part)
                column, u = column + wide, 0
            row, v = row + high, 0

    def _means(self, right: int, down: int, reduce: int) -> Image:
        """Return the tile's means over cells, of which the first begins at (right, down)."""
        if reduce == 1:
            return self._tile
        key = right, down, reduce
        if key not in self._reduced:
            made = np.empty((SIDE_PX // reduce, SIDE_PX // reduce, 3), np.uint8)
            average(np.roll(self._tile, (-down, -right), (0, 1)), made)
            self._reduced[key] = made
            if len(self._reduced) > MOST_KEPT:
                self._reduced.popitem(last=False)
        self._reduced.move_to_end(key)
        return self._reduced[key]


def _noise(rng: np.random.Generator, deviation: float) -> Image:
    """Return noise above zero, because adding unsigned numbers is four times as fast."""
    pad = 8
    drawn = rng.normal(0, 1, (SIDE_PX, SIDE_PX, 3)).astype(np.float32)
    roomy = np.pad(drawn, ((pad, pad), (pad, pad), (0, 0)), mode="wrap")
    soft = cv2.GaussianBlur(roomy, (0, 0), SOFT_PX)[pad:-pad, pad:-pad]
    scaled = soft * (deviation / float(soft.std())) + 2 * deviation
    return np.clip(np.round(scaled), 0, 40).astype(np.uint8)


def _drop(tile: Image, rng: np.random.Generator, larger: float) -> None:
    """Add the trace of one falling drop, which goes on at the opposite edge."""
    x, y = rng.integers(0, SIDE_PX, 2)
    near = rng.uniform(0.3, 1.0)
    long = int(np.clip(rng.uniform(*DROP_PX) * larger, 2, SIDE_PX // 2))
    wide = max(1, round(1.6 * near * larger))
    rows = (y + np.arange(long)) % SIDE_PX
    lean = (x + (np.arange(long) * rng.uniform(0.05, 0.15)).astype(int)) % SIDE_PX
    glow = np.sin(np.linspace(0, np.pi, long)) * 36 * near
    for column in range(wide):
        place = rows, (lean + column) % SIDE_PX
        tile[place] = np.clip(tile[place] + glow[:, None], 0, 90).astype(np.uint8)
