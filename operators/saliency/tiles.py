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
STRIDE_PX = 32  # of a detector's coarsest cells
Part = NDArray[np.int64]  # (4,) xyxy, pixels of the picture


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


def part_around(
    roi: NDArray[np.float32], size_px: tuple[int, int], tile_px: tuple[int, int], overlap_px: int
) -> tuple[Part, Part]:
    """The tile at a ROI (4,), and what it owns, in pixels of a picture of (width, height).

    Its middle is that of the ROI, and where the ROI ends with the picture, so does the tile: the
    target is then beside the ROI's middle. It moves by whole cells of a detector, so that what is
    at rest is found at the same place while the ROI moves. It owns nothing within half an overlap
    of its borders, where what it shows may be cut off, unless the picture ends there.

    >>> roi = np.array([530, 0, 1010, 270], np.float32)
    >>> [part.tolist() for part in part_around(roi, (1920, 1080), (384, 224), 48)]
    [[576, 0, 960, 224], [600, 0, 936, 200]]
    """
    size, tile = np.array(size_px), np.minimum(tile_px, size_px)
    cells = np.floor((roi[:2] + roi[2:] - tile) / 2 / STRIDE_PX + 0.5).astype(np.int64)
    begin = np.clip(cells * STRIDE_PX, 0, size - tile)
    first, last = roi[:2] < 0.5, roi[2:] > size - 0.5  # a ROI that is not rounded ends there, too
    begin = np.where(first & ~last, 0, np.where(last & ~first, size - tile, begin))
    end = begin + tile
    # the middle stays its own, by half a cell
    margin = np.maximum(np.minimum(overlap_px, tile - STRIDE_PX) // 2, 0)
    inner = np.where(begin > 0, begin + margin, 0), np.where(end < size, end - margin, size)
    return np.concatenate([begin, end]), np.concatenate(inner)


class Changes:
    """How much each tile of a fixed camera's pictures changed since it was last looked at."""

    def __init__(self, tiles: Grid, *, levels: float) -> None:
        self._tiles, self._levels = tiles, levels
        count = len(tiles.windows)
        self._age = np.zeros(count, np.int64)  # frames since a tile was looked at
        self._seen = np.zeros(count, np.bool_)
        self._reference = np.zeros((0, 0), np.uint8)  # as each tile was when looked at
        self._now = self._reference

    def compare(self, picture: NDArray[np.uint8]) -> None:
        """Take the next picture."""
        self._now = coarse(picture)
        if self._reference.shape != self._now.shape:
            self._reference = self._now.copy()
        self._age += 1

    def due(self, most: int, refresh: int) -> list[int]:
        """The tiles to look at in this picture, most urgent first, at most `most`.

        Urgent is what was never seen, then what changed much, or long ago; a tile that did not
        change has its turn when `refresh` frames have passed and no changed one needs its place.
        """
        changed = cv2.absdiff(self._now, self._reference) > self._levels
        # summed area: a tile's count of changed cells from four corners
        total = cv2.integral(changed.view(np.uint8))
        left, top, right, bottom = self._cells(self._tiles.cores).T
        counts = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
        # more than a person's change is no more urgent, or a crowd would keep a ball waiting
        urgency = np.minimum(counts, ENOUGH) * self._age.astype(np.float64)
        urgency = np.where((counts == 0) & (self._age >= refresh), 1e-3 * self._age, urgency)
        urgency[~self._seen] = UNSEEN
        order = np.argsort(-urgency, kind="stable")
        return [int(tile) for tile in order[:most] if urgency[tile] > 0]

    def looked_at_tile(self, tile: int) -> None:
        """Take note that a tile of the last picture is looked at."""
        self.looked_at(self._tiles.cores[tile])
        self._age[tile], self._seen[tile] = 0, True

    def looked_at(self, part: Part) -> None:
        """Take note that a part of the last picture is looked at."""
        left, top, right, bottom = self._cells(part)
        self._reference[top:bottom, left:right] = self._now[top:bottom, left:right]

    def _cells(self, parts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Parts (…, 4) of the picture in cells; neighbours share none."""
        height, width = self._now.shape
        return np.minimum(-(-parts // SHRINK), [width, height, width, height])


def coarse(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Brightness of each cell of 4x4 pixels: (h / 4, w / 4), at least one each."""
    height, width = picture.shape[:2]
    size = max(1, -(-width // SHRINK)), max(1, -(-height // SHRINK))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return np.asarray(
        cv2.cvtColor(small, cv2.COLOR_RGB2GRAY) if small.ndim == 3 else small, np.uint8
    )
