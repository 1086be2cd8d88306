"""A ground of any size: pictures laid side by side like tiles, read by windows.

The tiles are kept, the ground is not: 16320x9184 laid with two photographs takes their 160 MB, with
the drawn lawn 28, and 7 MB for each reduced copy.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.datasets.images import SUFFIXES
from drivers.datasets.pictures import read_picture
from drivers.readout import average
from drivers.scenes.soccer.pitch import blades, draw_turf
from pipeline.errors import DriverError

Image = NDArray[np.uint8]

STEP_PX = 48  # sides of tiles are multiples of it, so that 2, 3, 4, 6, 8, 12 and 16 divide them
LEAST_KEPT = 4  # reductions from this on are kept: a sixteenth of the tiles or less
STRIP_PX = 256  # rows of the ground that are averaged at a time
ACROSS = 4  # drawn tiles side by side
STRIPES = 4  # pairs of mown stripes in a drawn tile
LINE_SHARE = 0.005  # of a tile's width


class Ground:
    """`tiles` (h, w, 3) of one size, in turns, each row of them beginning with another."""

    def __init__(self, tiles: Sequence[Image]) -> None:
        self._tiles = tiles
        self._reduced: dict[int, list[Image]] = {1: list(tiles)}
        self._scratch = np.empty((0, 0, 3), np.uint8)

    @property
    def nbytes(self) -> int:
        """Bytes of the tiles and their reduced copies."""
        return sum(tile.nbytes for tiles in self._reduced.values() for tile in tiles)

    def read(self, left: int, top: int, reduce: int, out: Image) -> None:
        """Fill `out` (h, w, 3) with the window at (left, top), averaged over `reduce` squared."""
        height, width = self._tiles[0].shape[:2]
        divides = not (left % reduce or top % reduce or width % reduce or height % reduce)
        if reduce == 1 or (reduce >= LEAST_KEPT and divides):
            self._lay(self._copies(reduce), left // reduce, top // reduce, out)
            return
        rows = max(1, STRIP_PX // reduce)
        for first in range(0, len(out), rows):
            part = out[first : first + rows]
            shape = (len(part) * reduce, part.shape[1] * reduce, 3)
            if self._scratch.shape != shape:
                self._scratch = np.empty(shape, np.uint8)
            self._lay(self._reduced[1], left, top + first * reduce, self._scratch)
            average(self._scratch, part)

    def _copies(self, reduce: int) -> list[Image]:
        """Return the tiles, reduced; made when they are first asked for."""
        if reduce not in self._reduced:
            made = []
            for tile in self._tiles:
                small = np.empty((tile.shape[0] // reduce, tile.shape[1] // reduce, 3), np.uint8)
                average(tile, small)
                made.append(small)
            self._reduced[reduce] = made
        return self._reduced[reduce]

    def _lay(self, tiles: Sequence[Image], left: int, top: int, out: Image) -> None:
        """Copy the parts of the tiles that a window shows."""
        high, wide = tiles[0].shape[:2]
        bottom, right = top + out.shape[0], left + out.shape[1]
        for row in range(top // high, -(-bottom // high)):
            y0, y1 = max(top, row * high), min(bottom, (row + 1) * high)
            for column in range(left // wide, -(-right // wide)):
                x0, x1 = max(left, column * wide), min(right, (column + 1) * wide)
                tile = tiles[(row + column) % len(tiles)]
                out[y0 - top : y1 - top, x0 - left : x1 - left] = tile[
                    y0 - row * high : y1 - row * high, x0 - column * wide : x1 - column * wide
                ]


def photographs(path: str, size_px: tuple[int, int]) -> list[Image]:
    """Read the pictures of a folder, or one picture, as tiles of a ground of this size.

    All are cut to the smallest one, and only as many are read as the ground shows. Raises
    `DriverError` when there is none, or one that cannot be read or is too small.
    """
    place = Path(path)
    files = [place]
    if place.is_dir():
        files = sorted(file for file in place.iterdir() if file.suffix.lower() in SUFFIXES)
    if not files or not files[0].is_file():
        raise DriverError(f"{place}: expected a picture or a folder of pictures, got none")
    found: list[Image] = []
    for file in files:
        found = _cut([*found, _photograph(file)], size_px)
        height, width = found[0].shape[:2]
        if len(found) >= -(-size_px[0] // width) - (-size_px[1] // height) - 1:
            break  # rows and columns of the ground take no further turns
    return found


def _photograph(file: Path) -> Image:
    """Read one; raises `DriverError` for what is no picture, or too small."""
    picture = read_picture(file)
    if min(picture.shape[:2]) < STEP_PX:
        got = f"{picture.shape[1]}x{picture.shape[0]}"
        raise DriverError(f"{file}: expected sides of at least {STEP_PX} pixels, got {got}")
    return picture


def _cut(pictures: Sequence[Image], size_px: tuple[int, int]) -> list[Image]:
    """Cut pictures at once to the smallest, so that a tile is no larger than it has to be."""
    sides = []
    for axis, side in ((0, size_px[1]), (1, size_px[0])):
        least = min(picture.shape[axis] for picture in pictures)
        sides.append(min(least - least % STEP_PX, -(-side // STEP_PX) * STEP_PX))
    return [np.ascontiguousarray(picture[: sides[0], : sides[1]]) for picture in pictures]


def lawn(rng: np.random.Generator, size_px: tuple[int, int]) -> list[Image]:
    """Draw one tile of a lawn with mown stripes and white lines, for a ground of this size.

    Its left edge goes on where its right one ends, and so do the others.
    """
    width, height = (-(-side // (ACROSS * STEP_PX)) * STEP_PX for side in size_px)
    turf = draw_turf(rng, np.ones(3))
    across = np.sign(np.sin(2 * np.pi * STRIPES * (np.arange(width) + 0.5) / width))
    light = 1 + turf.stripe * across[None] + _worn(rng, (height // 8, width // 8), (height, width))
    tile = np.empty((height, width, 3), np.uint8)
    for channel, value in enumerate(turf.colour):
        tile[..., channel] = np.clip(light * value, 0, 255)
    grain = np.tile(blades(rng, turf.noise), (-(-height // 512), -(-width // 512)))
    for channel in range(3):
        plane = cv2.add(tile[..., channel], grain[:height, :width], dtype=cv2.CV_8U)
        tile[..., channel] = plane
    thick = max(1, round(LINE_SHARE * width))
    white = tuple(float(c) for c in np.array([245, 248, 242]) * turf.line)
    cv2.line(tile, (width // 2, 0), (width // 2, height), white, thick)
    cv2.line(tile, (0, height // 2), (width, height // 2), white, thick)
    return [tile]


def _worn(
    rng: np.random.Generator, coarse: tuple[int, int], size: tuple[int, int]
) -> NDArray[np.float32]:
    """Return slow changes of brightness that continue across the edges: `size` (h, w)."""
    y, x = (np.arange(side)[:, None] / side for side in coarse)
    total = np.zeros(coarse, np.float32)
    for _ in range(8):
        across, down = rng.integers(-3, 4, 2)
        wave = np.cos(2 * np.pi * (across * x.T + down * y) + rng.uniform(0, 2 * np.pi))
        total += np.float32(0.012) * wave.astype(np.float32)
    return np.asarray(cv2.resize(total, size[::-1]), np.float32)
