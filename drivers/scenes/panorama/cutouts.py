"""People and the ball, cut out at the size at which they are pasted, and the pasting itself."""

from collections import OrderedDict
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer import ball
from drivers.scenes.soccer.blend import extent
from drivers.scenes.soccer.figures import TALL_M, draw
from drivers.scenes.soccer.looks import everybody
from drivers.scenes.soccer.shadows import contact
from drivers.scenes.soccer.skeleton import DIRECTIONS, PHASES, Pose, pose_at

Image = NDArray[np.uint8]

PERSON_M = 1.8
DRAWN_PX = 400  # greatest height of a drawing; a larger cut-out is enlarged from it
MOST_BYTES = 192 << 20  # of cut-outs that are kept; 11 objects of 918 px use about half of it
MOST_REDUCED = 16  # reduced copies of a cut-out that are kept
TURNS = DIRECTIONS // 4  # people look to one of four sides, so that few cut-outs are needed
PACES = PHASES // 4
SHADE = 0.3  # darkness of the ground under an object


@dataclass(frozen=True, kw_only=True, eq=False)
class Cutout:
    """An object with the shadow under it."""

    patch: Image  # (h, w, 4) premultiplied RGBA
    feet: tuple[int, int]  # the point of the ground it stands on, pixels of the patch
    box: tuple[int, int, int, int]  # xyxy of what is seen of it, pixels of the patch
    _reduced: dict[tuple[int, int, int], Image] = field(default_factory=dict)

    @property
    def nbytes(self) -> int:
        """Bytes of the patch and its reduced copies."""
        return self.patch.nbytes + sum(copy.nbytes for copy in self._reduced.values())

    def paste(self, out: Image, left: int, top: int, reduce: int) -> None:
        """Lay it over `out` (h, w, 3), a window reduced by `reduce`, clipped at its edges.

        `left` and `top` are where the patch begins, in pixels before the reduction.
        """
        high, wide = self.patch.shape[:2]
        if -wide < left < out.shape[1] * reduce and -high < top < out.shape[0] * reduce:
            patch = self.patch if reduce == 1 else self._means(left % reduce, top % reduce, reduce)
            _over(out, patch, left // reduce, top // reduce)

    def _means(self, right: int, down: int, reduce: int) -> Image:
        """Return the means over cells that begin so far left of and above the patch."""
        key = right, down, reduce
        if key not in self._reduced:
            if len(self._reduced) >= MOST_REDUCED:
                self._reduced.clear()
            self._reduced[key] = _means(self.patch, right, down, reduce)
        return self._reduced[key]


class Cutouts:
    """Draws what is asked for, and keeps the last of it; the same for the same seed and size."""

    def __init__(self, seed: int, person_px: float, ball_px: float) -> None:
        self._looks = everybody(seed)
        self._discs = ball.discs(np.random.default_rng([seed, 31]), 1.0)
        self._px_per_m = person_px / PERSON_M
        self._ball_px = max(2, round(ball_px))
        self._kept: OrderedDict[tuple[int, Pose | int], Cutout] = OrderedDict()

    @property
    def px_per_m(self) -> float:
        """Pixels of a metre."""
        return self._px_per_m

    @property
    def nbytes(self) -> int:
        """Bytes of the cut-outs that are kept, with their reduced copies."""
        return sum(cutout.nbytes for cutout in self._kept.values())

    def person(self, who: int, speed_m_s: float, turn_rad: float, phase: float) -> Cutout:
        """Return a person of `looks.everybody` in the nearest pose that is drawn."""
        pose = pose_at(speed_m_s, False, phase, turn_rad)
        sides = DIRECTIONS // TURNS
        side = round(turn_rad / (2 * np.pi) * sides) % sides
        pose = Pose(
            gait=pose.gait, phase=pose.phase - pose.phase % PACES, direction=side * TURNS
        )  # fmt: skip
        return self._found((who, pose))

    def ball(self, rolled: float) -> Cutout:
        """Return the ball after so many turns."""
        return self._found((-1, int(rolled * ball.ROLLS) % ball.ROLLS))

    def _found(self, key: tuple[int, Pose | int]) -> Cutout:
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        who, how = key
        made = self._kept[key] = (
            self._draw_person(who, how) if isinstance(how, Pose) else self._draw_ball(how)
        )
        excess = self.nbytes - MOST_BYTES
        while excess > 0 and len(self._kept) > 1:
            excess -= self._kept.popitem(last=False)[1].nbytes
        return made

    def _draw_person(self, who: int, pose: Pose) -> Cutout:
        tall = self._px_per_m * TALL_M
        drawn = max(8, min(round(tall), DRAWN_PX))
        sprite = draw(self._looks[who], pose, drawn, np.ones(3), 0.3)
        metre = drawn / TALL_M
        shaded, feet = _shaded(sprite.image, sprite.feet, 0.3 * metre, 0.1 * metre)
        return _enlarged(shaded, feet, tall / drawn)

    def _draw_ball(self, rolled: int) -> Cutout:
        side = ball.DISC_PX
        shaded, feet = _shaded(self._discs[rolled], (side / 2, side * 5 / 6), side * 0.6, side / 4)
        return _enlarged(shaded, feet, self._ball_px / side)


def _shaded(
    image: Image, feet: tuple[float, float], wide_px: float, high_px: float
) -> tuple[Image, tuple[float, float]]:
    """Return an object on its shadow, an ellipse of these half axes, and where its feet are."""
    shadow = contact(max(1, round(wide_px)), max(1, round(high_px)), SHADE)
    left, top = round(feet[0]) - shadow.shape[1] // 2, round(feet[1]) - shadow.shape[0] // 2
    x0, y0 = min(0, left), min(0, top)
    x1 = max(image.shape[1], left + shadow.shape[1])
    y1 = max(image.shape[0], top + shadow.shape[0])
    patch = np.zeros((y1 - y0, x1 - x0, 4), np.uint8)
    patch[top - y0 :, left - x0 :][: shadow.shape[0], : shadow.shape[1]] = shadow
    place = patch[-y0:, -x0:][: image.shape[0], : image.shape[1]]
    rest = cv2.merge([cv2.bitwise_not(cv2.extractChannel(image, 3))] * 4)
    cv2.multiply(place, rest, dst=place, scale=1 / 255)
    cv2.add(place, image, dst=place)
    return patch, (feet[0] - x0, feet[1] - y0)


def _enlarged(patch: Image, feet: tuple[float, float], scale: float) -> Cutout:
    """Return the cut-out at its size, without the empty edges of its patch."""
    x0, y0, x1, y1 = extent(patch[..., 3], 2)
    tight = np.ascontiguousarray(patch[y0:y1, x0:x1])
    size = max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    made = np.asarray(cv2.resize(tight, size, interpolation=how), np.uint8)
    return Cutout(
        patch=made,
        feet=(round((feet[0] - x0) * scale), round((feet[1] - y0) * scale)),
        box=extent(made[..., 3]),  # a shadow is less opaque than what counts
    )


def _over(out: Image, patch: Image, left: int, top: int) -> None:
    """Lay a premultiplied RGBA patch over an RGB picture, clipped at its edges."""
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + patch.shape[1], out.shape[1]), min(top + patch.shape[0], out.shape[0])
    part = patch[y0 - top : y1 - top, x0 - left : x1 - left]
    place = out[y0:y1, x0:x1]
    rest = cv2.bitwise_not(cv2.extractChannel(part, 3))
    cv2.multiply(place, cv2.merge([rest] * 3), dst=place, scale=1 / 255)
    cv2.add(place, cv2.cvtColor(part, cv2.COLOR_RGBA2RGB), dst=place)


def _means(patch: Image, right: int, down: int, reduce: int) -> Image:
    """Return the patch's means over cells, of which the first begin before it."""
    high, wide = (
        -(-(side + before) // reduce) * reduce
        for side, before in zip(patch.shape[:2], (down, right), strict=True)
    )
    roomy = np.zeros((high, wide, 4), np.uint8)
    roomy[down:, right:][: patch.shape[0], : patch.shape[1]] = patch
    size = wide // reduce, high // reduce
    return np.asarray(cv2.resize(roomy, size, interpolation=cv2.INTER_AREA), np.uint8)
