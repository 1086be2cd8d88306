"""Cut a large picture into overlapping tiles, and tell which of them changed since they were seen.

Each tile owns the part of the picture that is nearer to its middle than to its neighbours': what is
found there is kept, so nothing is kept twice.
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

SHRINK = 4  # sides of the cells over which change is judged, in pixels
ENOUGH = 8  # changed cells, as many as a person of 9x17 pixels covers
UNSEEN = np.inf


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """n tiles of a picture, row by row."""

    windows: NDArray[np.int64]  # (n, 4) xyxy, pixels of the picture
    cores: NDArray[np.int64]  # (n, 4) xyxy: the part of the picture that each one owns


def grid(width_px: int, height_px: int, tile_px: tuple[int, int], overlap_px: int) -> Grid:
    """Tiles over the whole picture, evenly spaced; a picture smaller than a tile is one.

    >>> grid(2040, 1148, (480, 288), 48).windows.shape
    (25, 4)
    """
    columns = _spans(width_px, tile_px[0], overlap_px)
    rows = _spans(height_px, tile_px[1], overlap_px)
    boxes = [
        [(x[k], y[k], x[k + 1], y[k + 1]) for y in rows for x in columns]
        for k in (0, 2)  # a span is its tile, then its core
    ]
    return Grid(windows=np.array(boxes[0]), cores=np.array(boxes[1]))


def _spans(length: int, tile: int, overlap: int) -> list[tuple[int, int, int, int]]:
    """Tiles along one side: begin and end, begin and end of what each owns."""
    tile = min(tile, length)
    count = 1 if tile >= length else -(-(length - overlap) // (tile - overlap))
    begins = [round(k * (length - tile) / max(1, count - 1)) for k in range(count)]
    borders = [0, *((a + tile + b) // 2 for a, b in pairwise(begins)), length]
    return [(a, a + tile, borders[k], borders[k + 1]) for k, a in enumerate(begins)]


class Changes:
    """How much each tile of a fixed camera's pictures changed since it was last looked at."""

    def __init__(self, tiles: Grid, *, levels: float) -> None:
        self._tiles, self._levels = tiles, levels
        count = len(tiles.windows)
        self._age = np.zeros(count, np.int64)  # frames since a tile was looked at
        self._seen = np.zeros(count, np.bool_)
        self._reference = np.zeros((0, 0), np.uint8)  # as each tile was when looked at
        self._now = self._reference

    def due(self, picture: NDArray[np.uint8], most: int, refresh: int) -> list[int]:
        """The tiles to look at in this picture, most urgent first, at most `most`.

        Urgent is what was never seen, then what changed much, or long ago; a tile that did not
        change has its turn when `refresh` frames have passed and no changed one needs its place.
        """
        self._now = coarse(picture)
        if self._reference.shape != self._now.shape:
            self._reference = self._now.copy()
        self._age += 1
        changed = cv2.absdiff(self._now, self._reference) > self._levels
        # summed area: a tile's count of changed cells from four corners
        total = np.zeros((changed.shape[0] + 1, changed.shape[1] + 1), np.int64)
        total[1:, 1:] = changed.cumsum(0).cumsum(1)
        left, top, right, bottom = self._cells().T
        counts = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
        # more than a person's change is no more urgent, or a crowd would keep a ball waiting
        urgency = np.minimum(counts, ENOUGH) * self._age.astype(np.float64)
        urgency = np.where((counts == 0) & (self._age >= refresh), 1e-3 * self._age, urgency)
        urgency[~self._seen] = UNSEEN
        order = np.argsort(-urgency, kind="stable")
        return [int(tile) for tile in order[:most] if urgency[tile] > 0]

    def looked(self, tile: int) -> None:
        """Take note that a tile of the last picture was looked at."""
        left, top, right, bottom = self._cells()[tile]
        self._reference[top:bottom, left:right] = self._now[top:bottom, left:right]
        self._age[tile], self._seen[tile] = 0, True

    def _cells(self) -> NDArray[np.int64]:
        """What the tiles own, in cells; neighbours share none."""
        height, width = self._now.shape
        return np.minimum(-(-self._tiles.cores // SHRINK), [width, height, width, height])


def coarse(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Brightness of each cell of 4x4 pixels: (h / 4, w / 4), at least one each."""
    height, width = picture.shape[:2]
    size = max(1, -(-width // SHRINK)), max(1, -(-height // SHRINK))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return np.asarray(
        cv2.cvtColor(small, cv2.COLOR_RGB2GRAY) if small.ndim == 3 else small, np.uint8
    )
