"""Draw people: look and pose -> a premultiplied RGBA sprite, limb by limb, the farthest first."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import hypot, sin

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.blend import extent
from drivers.scenes.soccer.looks import Colour, Look
from drivers.scenes.soccer.skeleton import DIRECTIONS, Pose, joints, turned

Image = NDArray[np.uint8]
Seen = dict[str, tuple[float, float, float]]  # joints: x, y in pixels of the drawing, nearer in m

TALL_M, WIDE_M = 2.3, 2.2  # a sprite's frame
FEET_M = 0.28  # the ground point's height above the sprite's lower edge
OVERSAMPLE = 2
TILT = 0.2  # metres by which a point appears lower in the picture per metre that it is nearer
FOLDS = np.random.default_rng(7).normal(0, 0.09, (24, 24)).astype(np.float32)  # of the cloth
FONT = cv2.FONT_HERSHEY_SIMPLEX
NAME_SHARE = 0.28  # height of a name, of that of the number below it
LEAST_CONTRAST = 50  # grey levels between ink and shirt
LUMA = np.array([0.299, 0.587, 0.114])  # of R, G, B


@dataclass(frozen=True, kw_only=True)
class Print:
    """A text on the back of a shirt, and its box in pixels of the sprite."""

    text: str
    box: tuple[float, float, float, float]
    seen: float = 1.0  # share of its ink that the person's own arms and head leave
    clear: float = 1.0  # share of the shirt below and around it that has another brightness


@dataclass(frozen=True, kw_only=True, eq=False)
class Sprite:
    """A person cut out."""

    image: Image  # premultiplied RGBA
    feet: tuple[float, float]  # where the ground point is, its pixels
    prints: tuple[Print, ...] = ()  # on the back, where the back is seen


def draw(
    look: Look, pose: Pose, height_px: int, tint: NDArray[np.float64], soft_px: float
) -> Sprite:
    """Draw a person in a frame TALL_M by WIDE_M of `height_px`, cut to the visible part.

    `tint` is the light, per channel.
    """
    drawing = Drawing(height_px, tint)
    body = joints(pose, look.height_m, look.width)
    points = dict(zip(body, drawing.seen(turned(body, pose.direction)), strict=True))
    drawing.toward = sin(2 * np.pi * pose.direction / DIRECTIONS)
    parts: list[tuple[float, Callable[[Drawing, Seen, Look, str], None], str]] = [(0.0, _trunk, "")]
    for x in ("l", "r"):
        parts.append((min(points["hip" + x][2], points["toe" + x][2]) - 0.05, _leg, x))
        parts.append((points["elbow" + x][2] + points["hand" + x][2], _arm, x))
    for _, paint, which in sorted(parts, key=lambda part: part[0]):
        paint(drawing, points, look, which)
    whole = _finish(drawing.image, height_px, soft_px)
    x0, y0, x1, y1 = extent(whole[..., 3], 1)
    px_per_m = height_px / TALL_M
    return Sprite(
        image=np.ascontiguousarray(whole[y0:y1, x0:x1]),
        feet=(WIDE_M / 2 * px_per_m - x0, (TALL_M - FEET_M) * px_per_m - y0),
        prints=tuple(_shrunk(*each, drawing.image, x0, y0) for each in drawing.prints),
    )


class Drawing:
    """A large picture on which limbs are drawn; widths and radii are metres."""

    def __init__(self, height_px: int, tint: NDArray[np.float64]) -> None:
        self.scale = height_px * OVERSAMPLE / TALL_M
        size = (height_px * OVERSAMPLE, round(WIDE_M * self.scale), 4)
        self.image = np.zeros(size, np.uint8)
        self.tint = [float(t) for t in tint]
        self.toward = 0.0  # 1: the chest is seen, -1: the back
        self.prints: list[tuple[Print, Image]] = []  # on the back, and the drawing below each

    def seen(self, points: NDArray[np.float64]) -> list[tuple[float, float, float]]:
        """Project points (n, 3) right, nearer, up in metres: x, y in pixels, and nearer."""
        x = (WIDE_M / 2 + points[:, 0]) * self.scale
        y = (TALL_M - FEET_M - points[:, 2] + TILT * points[:, 1]) * self.scale
        return list(zip(x.tolist(), y.tolist(), points[:, 1].tolist(), strict=True))

    def rgba(self, colour: Colour, nearer: float) -> tuple[float, float, float, float]:
        """Return a colour as paint, darker on what is turned away from the camera."""
        shade = 0.93 + 0.25 * min(max(nearer, -0.35), 0.25)
        r, g, b = (min(255.0, c * t * shade) for c, t in zip(colour, self.tint, strict=True))
        return r, g, b, 255.0

    def limb(
        self,
        a: tuple[float, float, float],
        b: tuple[float, float, float],
        wide: tuple[float, float],
        colour: Colour,
    ) -> None:
        """Draw a rounded, tapering limb."""
        paint = self.rgba(colour, (a[2] + b[2]) / 2)
        dx, dy = b[0] - a[0], b[1] - a[1]
        half = self.scale / 2 / (hypot(dx, dy) + 1e-6)
        ux, uy, (wa, wb) = -dy * half, dx * half, wide
        corners = np.array(
            [
                (a[0] + ux * wa, a[1] + uy * wa),
                (b[0] + ux * wb, b[1] + uy * wb),
                (b[0] - ux * wb, b[1] - uy * wb),
                (a[0] - ux * wa, a[1] - uy * wa),
            ]
        )
        cv2.fillConvexPoly(self.image, corners.astype(np.int32), paint)
        for end, width in ((a, wa), (b, wb)):
            radius = max(1, round(width / 2 * self.scale))
            cv2.circle(self.image, (int(end[0]), int(end[1])), radius, paint, -1)

    def spot(
        self, at: tuple[float, float, float], lift_m: float, radius_m: float, colour: Colour
    ) -> None:
        """Draw a disc `lift_m` above a joint."""
        place = int(at[0]), int(at[1] - lift_m * self.scale)
        radius = max(1, round(radius_m * self.scale))
        cv2.circle(self.image, place, radius, self.rgba(colour, at[2]), -1)


def between(
    a: tuple[float, float, float], b: tuple[float, float, float], share: float
) -> tuple[float, float, float]:
    """Return the point at a share of the way from a to b."""
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
    )


def _leg(drawing: Drawing, points: Seen, look: Look, x: str) -> None:
    hip, knee, ankle, toe = (points[k + x] for k in ("hip", "knee", "ankle", "toe"))
    w = look.width
    drawing.limb(hip, knee, (0.17 * w, 0.125 * w), look.skin)
    drawing.limb(knee, ankle, (0.125 * w, 0.08 * w), look.skin)
    drawing.limb(between(knee, ankle, 0.12), ankle, (0.13 * w, 0.085 * w), look.socks)
    drawing.limb(between(ankle, toe, -0.2), toe, (0.1, 0.075), look.boots)
    drawing.limb(hip, between(hip, knee, 0.66), (0.2 * w, 0.205 * w), look.shorts)


def _arm(drawing: Drawing, points: Seen, look: Look, x: str) -> None:
    shoulder, elbow, hand = (points[k + x] for k in ("shoulder", "elbow", "hand"))
    sleeve = look.trim if look.pattern == "sleeves" else look.shirt
    cover = sleeve if look.long_sleeves else look.skin
    drawing.limb(elbow, hand, (0.085, 0.06), cover)
    drawing.limb(shoulder, elbow, (0.11, 0.09), cover)
    drawing.limb(shoulder, between(shoulder, elbow, 0.75), (0.125, 0.13), sleeve)
    drawing.spot(hand, 0, 0.085 if look.gloves else 0.05, look.trim if look.gloves else look.skin)


def _trunk(drawing: Drawing, points: Seen, look: Look, _: str) -> None:
    left, right, hips = points["shoulderl"], points["shoulderr"], points["hips"]
    waist = between(hips, between(left, right, 0.5), 0.16)
    top_l, top_r = between(left, right, 0.2), between(left, right, 0.8)
    half = (right[0] - left[0]) * 0.27
    low_l, low_r = ((waist[0] + side * half, waist[1], 0.0) for side in (-1, 1))
    wide = 0.19 * look.width
    drawing.limb(points["hipl"], points["hipr"], (wide, wide), look.shorts)
    drawing.limb(between(low_l, low_r, 0.5), hips, (0.28, 0.24), look.shorts)
    hull = cv2.convexHull(np.array([p[:2] for p in (top_l, top_r, low_r, low_l)], np.int32))
    paint = drawing.rgba(look.shirt, 0.1 * drawing.toward)
    cv2.fillConvexPoly(drawing.image, hull, paint)
    cv2.polylines(drawing.image, [hull], True, paint, max(1, round(wide * drawing.scale)))
    _decorate(drawing, look, np.asarray(hull.reshape(-1, 2), np.int32))
    neck, head = points["neck"], points["head"]
    drawing.limb(neck, head, (0.11, 0.11), look.skin)
    drawing.spot(neck, 0, 0.07, look.trim if look.pattern != "plain" else look.shirt)
    _head(drawing, head, look)


def _head(drawing: Drawing, head: tuple[float, float, float], look: Look) -> None:
    drawing.spot(head, 0, 0.105, look.skin)
    drawing.spot(head, -0.05, 0.085, look.skin)
    if look.hair_style == 0:
        return
    front = drawing.toward > 0.2
    drawing.spot(head, 0.06 if front else 0.035, 0.09 + 0.012 * look.hair_style, look.hair)
    if front:
        drawing.spot(head, -0.03, 0.085, look.skin)
    if look.hair_style == 3:
        drawing.spot(head, 0.14, 0.045, look.hair)


def _decorate(drawing: Drawing, look: Look, hull: NDArray[np.int32]) -> None:
    """Draw pattern and number on the shirt; `hull`: its corners in the drawing."""
    (x0, y0), (x1, y1) = hull.min(0).tolist(), hull.max(0).tolist()
    paint = drawing.rgba(look.trim, 0.1)
    middle, step = (x0 + x1) // 2, max(2, round(0.08 * drawing.scale))
    if look.pattern == "stripes":
        for k in (-1, 0, 1):
            x = middle + round(k * (x1 - x0) * 0.48)
            cv2.line(drawing.image, (x, y0), (x, y1), paint, max(1, (x1 - x0) // 4))
    elif look.pattern == "hoops":
        for y in range(y0, y1, step * 2):
            cv2.line(drawing.image, (x0, y), (x1, y), paint, step)
    elif look.pattern == "sash":
        cv2.line(drawing.image, (x0, y0), (x1, y1), paint, step)
    elif look.pattern == "halves" and abs(drawing.toward) > 0.5:
        cv2.rectangle(drawing.image, (middle, y0), (x1, y1), paint, -1)
    if abs(drawing.toward) > 0.6:
        tall = y1 - y0
        if look.number:
            big, low = (1.0 if drawing.toward < 0 else 0.5), 0.54 if look.name else 0.45
            _print(drawing, look, look.number, (middle, round(y0 + low * tall)), big)
        if look.name and drawing.toward < 0:
            _print(drawing, look, look.name, (middle, round(y0 + 0.08 * tall)), NAME_SHARE)


def _print(drawing: Drawing, look: Look, text: str, at: tuple[int, int], big: float) -> None:
    """Draw a text in the middle of `at`; `big` is its height's share of a number on the back."""
    size, thick = big * 0.0115 * drawing.scale, max(1, round(big * 0.042 * drawing.scale))
    (w, h), _ = cv2.getTextSize(text, FONT, size, thick)
    left, low = at[0] - w // 2, at[1] + h // 2
    box = (left, low - h, left + w, low)
    paint = drawing.rgba(look.ink, 0.1)
    clear = _clear(_within(drawing.image, box), paint) if drawing.toward < 0 else 1.0
    cv2.putText(drawing.image, text, (left, low), FONT, size, paint, thick)
    if drawing.toward < 0:
        print_ = Print(text=text, box=box, clear=clear)
        drawing.prints.append((print_, _within(drawing.image, box).copy()))


def _within(image: Image, box: tuple[float, float, float, float]) -> Image:
    x0, y0, x1, y1 = (max(0, int(side)) for side in box)
    return image[y0:y1, x0:x1]


def _clear(shirt: Image, ink: tuple[float, ...]) -> float:
    """Return the share of a shirt (h, w, 4) on which ink stands out: white on white does not."""
    apart = np.abs((shirt[..., :3] - np.array(ink[:3])) @ LUMA)
    return float((apart >= LEAST_CONTRAST).mean()) if apart.size else 0.0


def _shrunk(print_: Print, drawn: Image, whole: Image, left: int, top: int) -> Print:
    """Return a print in pixels of the sprite, which begins at `left`, `top`.

    `drawn` is what its box showed when it was drawn, `whole` the finished drawing.
    """
    x0, y0, x1, y1 = (side / OVERSAMPLE for side in print_.box)
    same = (drawn == _within(whole, print_.box)).all(-1)
    return replace(print_, box=(x0 - left, y0 - top, x1 - left, y1 - top), seen=float(same.mean()))


def _finish(image: Image, height_px: int, soft_px: float) -> Image:
    """Shrink a drawing, shade it so that forms look round, and soften it."""
    size = (round(WIDE_M * height_px / TALL_M), height_px)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    k = max(3, height_px // 24) | 1
    body = cv2.blur(small[..., 3], (k, k)).astype(np.float32)
    shift = max(1, k // 3)
    relief = cv2.filter2D(body, -1, _slope(shift))
    light = np.clip(cv2.resize(FOLDS, size) + relief + 1, 0.5, 1.4)
    lit = cv2.multiply(
        small, cv2.merge([light, light, light, np.ones_like(light)]), dtype=cv2.CV_8U
    )
    return np.asarray(cv2.GaussianBlur(lit, (0, 0), soft_px) if soft_px > 0.2 else lit, np.uint8)


def _slope(shift: int) -> NDArray[np.float32]:
    """Return the kernel that is bright where a form turns to the upper left."""
    kernel = np.zeros((2 * shift + 1, 2 * shift + 1), np.float32)
    kernel[shift, -1], kernel[shift, 0] = 0.32, -0.32
    kernel[-1, shift], kernel[0, shift] = 0.19, -0.19
    return np.asarray(kernel / 255, np.float32)
