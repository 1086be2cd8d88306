"""Compose one frame: moment and view -> sprites in drawing order, and ground truth."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil, log

import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.blend import extent, placed, smeared
from drivers.scenes.soccer.camera import View
from drivers.scenes.soccer.figures import Print, Sprite
from drivers.scenes.soccer.play import LABELS, Moment
from drivers.scenes.soccer.skeleton import Pose, pose_at
from drivers.source import Annotations

Image = NDArray[np.uint8]
Sprites = Callable[[int, Pose, int], Sprite]

BALL_ID = len(LABELS) + 1
STEP = 1.3  # between the heights in which sprites are kept
MOST_PX = 1400
LEAST_INSIDE_PX = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Actor:
    """One person or the ball in the picture."""

    id: int
    label: str
    patch: Image  # premultiplied RGBA
    left: int
    top: int
    box: tuple[int, int, int, int]  # xyxy in the picture, not clipped
    nearer: float  # order of drawing: larger is in front
    ground: tuple[float, float]  # the point of the ground below it, picture pixels
    scale: float  # pixels per metre there
    solid: int = 100  # opacity from which a pixel belongs to it
    prints: tuple[Print, ...] = ()  # on the shirt, their boxes in the picture


class Cache:
    """The sprites drawn last, at most `most_bytes` of them."""

    def __init__(self, make: Sprites, most_bytes: int) -> None:
        self._make = make
        self._kept: OrderedDict[tuple[int, Pose, int], Sprite] = OrderedDict()
        self._most = self._left = most_bytes

    @property
    def nbytes(self) -> int:
        """Bytes of the sprites that are kept."""
        return self._most - self._left

    def __call__(self, who: int, pose: Pose, height_px: int) -> Sprite:
        key = (who, pose, height_px)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        made = self._make(who, pose, height_px)
        self._kept[key] = made
        self._left -= made.image.nbytes
        while self._left < 0 and len(self._kept) > 1:
            self._left += self._kept.popitem(last=False)[1].image.nbytes
        return made


def sprite_height(wanted_px: float) -> int:
    """Return the kept height at or above the one wanted: sprites are shrunk, never enlarged."""
    step = ceil(log(max(wanted_px, 8.0) / 8) / log(STEP))
    return min(round(8 * STEP**step), MOST_PX)


def actors_at(
    moment: Moment,
    view: View,
    opened: tuple[Moment, View],
    sprites: Sprites,
    frame_m: float,
) -> list[Actor]:
    """Return the people in the picture, the farthest first; `frame_m`: a sprite's height in metres.

    `opened` is the state when the shutter opened; people who moved since then are blurred.
    """
    spots = np.column_stack([moment.people, np.zeros(len(moment.people))])
    pixels, scales = view.pixels(spots), view.px_per_m(spots)
    before = np.column_stack([opened[0].people, np.zeros(len(moment.people))])
    ways = pixels - opened[1].pixels(before)
    bearings = view.station.angles(spots)[:, 0]
    reach = view.station.distance_m(spots)
    made = []
    for who in np.argsort(-reach):
        tall = float(scales[who]) * frame_m
        x, y = pixels[who]
        if not (-tall < x < view.size_px[0] + tall and -tall < y < view.size_px[1] + tall):
            continue
        turn = float(moment.heading[who] - bearings[who])
        speed, holds = float(moment.speed[who]), bool(who == moment.carrier)
        pose = pose_at(speed, holds, float(moment.phase[who]), turn)
        height = sprite_height(tall)
        shrink = tall / height
        sprite = sprites(int(who), pose, height)
        patch, left, top = placed(sprite.image, shrink, sprite.feet, (float(x), float(y)))
        origin = float(x) - sprite.feet[0] * shrink, float(y) - sprite.feet[1] * shrink
        patch, left, top = smeared(patch, left, top, (float(ways[who, 0]), float(ways[who, 1])))
        x0, y0, x1, y1 = extent(patch[..., 3])
        made.append(
            Actor(
                id=int(who) + 1,
                label=LABELS[who],
                patch=patch,
                left=left,
                top=top,
                box=(left + x0, top + y0, left + x1, top + y1),
                nearer=-float(reach[who]),
                ground=(float(x), float(y)),
                scale=float(scales[who]),
                prints=tuple(_printed(each, shrink, origin) for each in sprite.prints),
            )
        )
    return made


def _printed(print_: Print, shrink: float, origin: tuple[float, float]) -> Print:
    """Return a print of a sprite as it lies in the picture."""
    x0, y0, x1, y1 = (side * shrink for side in print_.box)
    box = x0 + origin[0], y0 + origin[1], x1 + origin[0], y1 + origin[1]
    return replace(print_, box=box)


def truth_of(
    actors: list[Actor], size_px: tuple[int, int], least_px: float = LEAST_INSIDE_PX
) -> Annotations:
    """Return clipped boxes and visible shares of actors given in the order of drawing.

    One of whose box less than `least_px` is in the picture, in width or height, is left out.
    """
    w, h = size_px
    rows: list[tuple[list[float], int, str, float]] = []
    for i, actor in enumerate(actors):
        x0, y0, x1, y1 = actor.box
        clipped = [float(min(max(v, 0), s)) for v, s in zip(actor.box, (w, h, w, h), strict=True)]
        if min(clipped[2] - clipped[0], clipped[3] - clipped[1]) < least_px:
            continue
        mask = actor.patch[..., 3] >= actor.solid
        whole = max(1, int(mask.sum()))
        left, top = actor.left, actor.top
        mask = mask.copy()
        mask[: max(0, -top)] = False
        mask[max(0, h - top) :] = False
        mask[:, : max(0, -left)] = False
        mask[:, max(0, w - left) :] = False
        for other in actors[i + 1 :]:
            ox0, oy0, ox1, oy1 = other.box
            ix0, iy0, ix1, iy1 = max(x0, ox0), max(y0, oy0), min(x1, ox1), min(y1, oy1)
            if ix0 < ix1 and iy0 < iy1:
                hides = other.patch[
                    iy0 - other.top : iy1 - other.top, ix0 - other.left : ix1 - other.left, 3
                ]
                mask[iy0 - top : iy1 - top, ix0 - left : ix1 - left] &= hides < other.solid
        rows.append((clipped, actor.id, actor.label, float(mask.sum()) / whole))
    rows.sort(key=lambda row: row[1])
    return Annotations(
        boxes=np.array([r[0] for r in rows], np.float32).reshape(-1, 4),
        ids=np.array([r[1] for r in rows], np.int32),
        labels=tuple(r[2] for r in rows),
        visibility=np.array([r[3] for r in rows], np.float32),
    )
