"""The scanpath as a raster: one row per object, one column per frame, probability as shade."""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.messages import Scanpath

PAST_FRAMES = 48
MOST_ROWS = 8  # the objects that were the likeliest in these frames
LEAST = 0.01  # the probability from which an object has a row
DARK, BRIGHT = np.array((28, 28, 36)), np.array((255, 225, 0))


class Raster(NamedTuple):
    """A picture with one pixel per object and frame; of the same height for few objects, too."""

    ids: tuple[int, ...]  # of the rows
    shades: NDArray[np.uint8]  # (MOST_ROWS, PAST_FRAMES + horizon, 3)


class ScanpathRaster:
    """What the policy meant to look at, and means to; memory for `PAST_FRAMES` frames."""

    def __init__(self) -> None:
        self._past: deque[tuple[int, dict[int, float]]] = deque(maxlen=PAST_FRAMES)

    def add(self, scanpath: Scanpath) -> Raster:
        """Take a scanpath; return the raster, whose column PAST_FRAMES is its first frame."""
        ids = [int(i) for i in scanpath.ids]
        plan = [dict(zip(ids, map(float, row), strict=True)) for row in scanpath.probability]
        first = scanpath.first_seq
        cells = [(seq - first + PAST_FRAMES, row) for seq, row in self._past]
        cells = [(at, row) for at, row in cells if 0 <= at < PAST_FRAMES]
        cells += [(PAST_FRAMES + k, row) for k, row in enumerate(plan)]
        if plan:
            self._past.append((first, {i: p for i, p in plan[0].items() if p > 0}))
        most: dict[int, float] = {}
        for _at, row in cells:
            for i, p in row.items():
                most[i] = max(most.get(i, 0.0), p)
        likely = sorted((i for i in most if most[i] >= LEAST), key=lambda i: -most[i])
        rows = tuple(sorted(likely[:MOST_ROWS]))
        share = np.zeros((MOST_ROWS, PAST_FRAMES + len(plan)), np.float32)
        for at, row in cells:
            share[: len(rows), at] = [row.get(i, 0.0) for i in rows]
        # faint ones are seen, too: the shade is the probability's square root
        shade = np.sqrt(share.clip(0, 1))[..., None]
        return Raster(rows, (DARK + shade * (BRIGHT - DARK)).astype(np.uint8))
