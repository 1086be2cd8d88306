"""Flat things of a street: what is drawn on them, and where they stand in metres.

Coordinates: x to the right of the camera's path, y up from the road, z along the road.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.road.lettering import LETTERS_PX, lettering

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

MOST_SIDE_PX = 1024  # of what is drawn on a panel


@dataclass(frozen=True, kw_only=True)
class Lettered:
    """A text on a panel."""

    id: int
    text: str
    foreign: bool
    # the rectangle of its ink, as shares of the panel: left, top, right, bottom
    place: tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """A rectangle in space with a picture on it; its size in memory falls by halves."""

    origin: tuple[float, float, float]  # its upper left corner as it is read
    along: tuple[float, float, float]  # to the upper right corner
    down: tuple[float, float, float]  # to the lower left corner
    picture: Image  # (h, w, 4) premultiplied RGBA
    texts: tuple[Lettered, ...] = ()
    wall: bool = False  # behind everything that is no wall
    drives: bool = False  # along with the camera
    _halves: list[Image] = field(default_factory=list)

    def corners(
        self, place: tuple[float, float, float, float] = (0, 0, 1, 1)
    ) -> NDArray[np.float64]:
        """Return the corners (4, 3) of a part of it, clockwise from the upper left, metres."""
        left, top, right, low = place
        origin, along, down = (np.array(v, float) for v in (self.origin, self.along, self.down))
        shares = ((left, top), (right, top), (right, low), (left, low))
        return np.array([origin + a * along + b * down for a, b in shares])

    def reduced(self, factor: float) -> Image:
        """Return the picture, halved as often as it is at least `factor` times too large."""
        if not self._halves:
            self._halves.append(self.picture)
        level = max(0, int(np.log2(max(factor, 1.0))))
        while len(self._halves) <= level and min(self._halves[-1].shape[:2]) >= 4:
            last = self._halves[-1]
            size = last.shape[1] // 2, last.shape[0] // 2
            self._halves.append(np.asarray(cv2.resize(last, size, interpolation=cv2.INTER_AREA)))
        return self._halves[min(level, len(self._halves) - 1)]


def board(
    lines: list[tuple[int, str, bool]], font: Path, *, letter_m: float, ink: Colour, ground: Colour,
    light: float, margin: float = 0.45, rim: bool = False,
) -> tuple[Image, tuple[float, float], tuple[Lettered, ...]]:  # fmt: skip
    """Draw lines (id, text, foreign) on a board: its picture, its size in metres, its texts.

    `letter_m` is the height of a font's size; `light` is what comes off it, 0..1.
    """
    inks = [lettering(font, text) for _, text, _ in lines]
    gap = round(margin * LETTERS_PX)
    wide = max(ink_.shape[1] for ink_ in inks) + 2 * gap
    high = sum(ink_.shape[0] + gap for ink_ in inks) + gap
    drawn = np.empty((high, wide, 3), np.float32)
    drawn[:] = ground
    texts, top = [], gap
    for (id_, text, foreign), shape in zip(lines, inks, strict=True):
        h, w = shape.shape
        left = (wide - w) // 2
        share = shape[..., None].astype(np.float32) / 255
        part = drawn[top : top + h, left : left + w]
        part[:] = part * (1 - share) + np.array(ink, np.float32) * share
        place = (left / wide, top / high, (left + w) / wide, (top + h) / high)
        texts.append(Lettered(id=id_, text=text, foreign=foreign, place=place))
        top += h + gap
    if rim:
        cv2.rectangle(drawn, (4, 4), (wide - 5, high - 5), ink, 4)
    metre = letter_m / LETTERS_PX
    return (
        opaque(np.clip(drawn * np.float32(light), 0, 255), MOST_SIDE_PX),
        (wide * metre, high * metre),
        tuple(texts),
    )


def opaque(drawn: NDArray[Any], most_px: int = MOST_SIDE_PX) -> Image:
    """Return an RGB drawing as opaque RGBA with a transparent rim, for smooth edges."""
    shrink = min(1.0, most_px / max(drawn.shape[:2]))
    if shrink < 1:
        drawn = np.asarray(
            cv2.resize(drawn, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        )
    rgba = np.zeros((*drawn.shape[:2], 4), np.uint8)
    rgba[..., :3], rgba[..., 3] = drawn, 255
    return rgba
