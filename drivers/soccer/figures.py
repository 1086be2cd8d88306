"""Draw people: look, gait, phase and direction -> a premultiplied RGBA sprite.

A skeleton of fifteen joints moves in its own frame (forward, right, up; metres), is turned to the
camera and drawn limb by limb, the farthest first.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.soccer.looks import Colour, Look

Image = NDArray[np.uint8]
Vector = NDArray[np.float64]

DIRECTIONS = 12
PHASES = 10
GAITS = ("stand", "walk", "jog", "run", "hold")
TALL_M = 2.3  # height and width of a sprite's frame
WIDE_M = 2.2
FEET_M = 0.28  # the ground point's height above the sprite's lower edge
OVERSAMPLE = 3
TILT = 0.2  # how much lower in the picture what is a metre nearer appears, in metres

FOLDS = np.random.default_rng(7).normal(0, 0.09, (24, 24)).astype(np.float32)  # of the cloth

# swing of the hips, bend of knees and elbows (radians), lean, bounce (m), arms out (radians)
STYLES = {
    "stand": (0.06, 0.08, 0.25, 0.03, 0.0, 0.22),
    "walk": (0.42, 0.5, 0.35, 0.05, 0.02, 0.12),
    "jog": (0.7, 1.2, 1.3, 0.12, 0.04, 0.15),
    "run": (0.98, 1.75, 1.6, 0.28, 0.06, 0.18),
    "hold": (0.1, 0.1, 1.5, 0.06, 0.0, 0.0),
}


@dataclass(frozen=True, kw_only=True)
class Pose:
    """A key of the sprite cache."""

    gait: str
    phase: int  # of PHASES
    direction: int  # of DIRECTIONS; 0 looks to the right of the picture, 1/4 turn: to the camera


def gait(speed_m_s: float, holds: bool) -> str:
    """The way of moving at a speed."""
    if holds:
        return "hold"
    return GAITS[int(np.searchsorted([0.5, 2.2, 4.3], speed_m_s))]


def skeleton(pose: Pose, look: Look) -> dict[str, Vector]:
    """Joints in the body's frame: forward, right, up in metres, the ground at 0."""
    swing, knee, elbow, lean, bounce, out = STYLES[pose.gait]
    angle = 2 * np.pi * pose.phase / PHASES
    tall = look.height_m
    hip_up = 0.5 * tall
    joints: dict[str, Vector] = {}
    for name, side, turn in (("l", -1, angle), ("r", 1, angle + np.pi)):
        thigh = swing * np.sin(turn) + lean * 0.4
        bend = knee * max(0.08, 0.5 + 0.5 * np.cos(turn + 0.5)) ** 1.3
        hip = np.array([0, 0.1 * side * look.width, hip_up])
        joints["hip" + name] = hip
        joints["knee" + name] = hip + _rod(0.25 * tall, thigh, 0.02 * side)
        joints["ankle" + name] = joints["knee" + name] + _rod(0.23 * tall, thigh - bend, 0.0)
        toe = thigh - bend * 0.8
        joints["toe" + name] = joints["ankle" + name] + 0.17 * np.array(
            [np.cos(toe), 0.1 * side, np.sin(toe) - 0.25]
        )
    chest = np.array([np.sin(lean), 0, np.cos(lean)]) * 0.3 * tall
    neck = np.array([0, 0, hip_up]) + chest
    joints |= {"hips": np.array([0, 0, hip_up]), "neck": neck}
    joints["head"] = neck + np.array([0.05 + 0.06 * lean, 0, 0.085 * tall])
    for name, side, turn in (("l", -1, angle + np.pi), ("r", 1, angle)):
        arm = 0.9 * swing * np.sin(turn) + (0.5 if pose.gait == "hold" else 0.0)
        shoulder = neck + np.array([0, 0.19 * side * look.width, -0.045 * tall])
        joints["shoulder" + name] = shoulder
        inward = -0.35 * side if pose.gait == "hold" else out * side
        joints["elbow" + name] = shoulder + _rod(0.165 * tall, arm, inward)
        joints["hand" + name] = joints["elbow" + name] + _rod(0.17 * tall, arm + elbow, inward)
    lowest = min(joints[k][2] for k in ("anklel", "ankler", "toel", "toer"))
    rise = bounce * abs(np.sin(angle)) - lowest + 0.05
    return {k: v + np.array([0, 0, rise]) for k, v in joints.items()}


def _rod(length: float, forward: float, aside: float) -> Vector:
    """A limb hanging down, swung forward and aside by angles."""
    return length * np.array([np.sin(forward), np.sin(aside), -np.cos(forward) * np.cos(aside)])


class Drawing:
    """A large canvas on which limbs are drawn in screen coordinates (right, nearer, up)."""

    def __init__(self, height_px: int, light: Vector) -> None:
        self.scale = height_px * OVERSAMPLE / TALL_M
        size = (round(TALL_M * self.scale), round(WIDE_M * self.scale), 4)
        self.image = np.zeros(size, np.uint8)
        self.light = light

    def at(self, p: Vector) -> tuple[int, int]:
        x = (WIDE_M / 2 + p[0]) * self.scale
        y = (TALL_M - FEET_M - p[2] + TILT * p[1]) * self.scale
        return round(x), round(y)

    def rgba(self, colour: Colour, nearer: float) -> tuple[float, float, float, float]:
        """Paint, somewhat darker on what is turned away from the camera."""
        shade = self.light * (0.93 + 0.25 * float(np.clip(nearer, -0.35, 0.25)))
        r, g, b = (min(255.0, float(c * s)) for c, s in zip(colour, shade, strict=True))
        return r, g, b, 255.0

    def limb(self, a: Vector, b: Vector, wide_a: float, wide_b: float, colour: Colour) -> None:
        """A rounded, tapering limb; widths in metres."""
        paint = self.rgba(colour, float(a[1] + b[1]) / 2)
        pa, pb = np.array(self.at(a), float), np.array(self.at(b), float)
        way = pb - pa
        across = np.array([-way[1], way[0]]) / (np.linalg.norm(way) + 1e-6) * self.scale / 2
        corners = [pa + across * wide_a, pb + across * wide_b, pb - across * wide_b]
        corners.append(pa - across * wide_a)
        cv2.fillConvexPoly(self.image, np.round(corners).astype(np.int32), paint)
        self.spot(a, wide_a / 2, colour)
        self.spot(b, wide_b / 2, colour)

    def spot(self, p: Vector, radius_m: float, colour: Colour) -> None:
        paint = self.rgba(colour, float(p[1]))
        cv2.circle(self.image, self.at(p), max(1, round(radius_m * self.scale)), paint, -1)


def draw(look: Look, pose: Pose, height_px: int, light: Vector, soft_px: float) -> Image:
    """A sprite `height_px` tall, premultiplied; `feet` says where its ground point is."""
    turn = 2 * np.pi * pose.direction / DIRECTIONS
    c, s = np.cos(turn), np.sin(turn)
    joints = {
        k: np.array([v[0] * c - v[1] * s, v[0] * s + v[1] * c, v[2]])
        for k, v in skeleton(pose, look).items()
    }
    drawing = Drawing(height_px, light)
    parts = [(min(joints["hip" + x][1], joints["toe" + x][1]) - 0.05, _leg, x) for x in ("l", "r")]
    parts += [(joints["elbow" + x][1] + joints["hand" + x][1], _arm, x) for x in ("l", "r")]
    parts += [(0.0, _trunk, str(s))]
    for _, paint, which in sorted(parts, key=lambda part: part[0]):
        paint(drawing, joints, look, which)
    return _finish(drawing.image, height_px, soft_px)


def feet(height_px: int) -> tuple[float, float]:
    """The ground point within a sprite: x, y in its pixels."""
    return WIDE_M / 2 * height_px / TALL_M, (TALL_M - FEET_M) * height_px / TALL_M


def _leg(drawing: Drawing, j: dict[str, Vector], look: Look, x: str) -> None:
    hip, knee, ankle, toe = (j[k + x] for k in ("hip", "knee", "ankle", "toe"))
    w = look.width
    drawing.limb(hip, knee, 0.17 * w, 0.12 * w, look.skin)
    drawing.limb(knee, ankle, 0.125 * w, 0.08 * w, look.skin)
    drawing.limb(knee + (ankle - knee) * 0.12, ankle, 0.125 * w, 0.085 * w, look.socks)
    drawing.limb(ankle - 0.1 * (toe - ankle), toe, 0.1, 0.075, look.boots)
    drawing.limb(hip, hip + (knee - hip) * 0.68, 0.2 * w, 0.2 * w, look.shorts)


def _arm(drawing: Drawing, j: dict[str, Vector], look: Look, x: str) -> None:
    shoulder, elbow, hand = (j[k + x] for k in ("shoulder", "elbow", "hand"))
    sleeve = look.trim if look.pattern == "sleeves" else look.shirt
    drawing.limb(elbow, hand, 0.085, 0.065, sleeve if look.long_sleeves else look.skin)
    drawing.limb(shoulder, elbow, 0.11, 0.09, sleeve if look.long_sleeves else look.skin)
    drawing.limb(shoulder, shoulder + (elbow - shoulder) * 0.75, 0.125, 0.125, sleeve)
    drawing.spot(hand, 0.085 if look.gloves else 0.045, look.trim if look.gloves else look.skin)


def _trunk(drawing: Drawing, j: dict[str, Vector], look: Look, facing: str) -> None:
    toward = float(facing)  # 1: the chest is seen, -1: the back
    left, right = j["shoulderl"], j["shoulderr"]
    hips, neck = j["hips"], j["neck"]
    deep = np.array([0.1, 0, 0])
    waist = (j["hipr"] - j["hipl"]) * 0.75
    outline = [left - deep * np.sign(left[0] - right[0]) * -0.4, right, hips + waist, hips - waist]
    flat = [drawing.at(p) for p in outline]
    thick = round(0.17 * look.width * drawing.scale)
    for colour, low in ((look.shorts, 0.1), (look.shirt, -0.02)):
        paint = drawing.rgba(colour, 0.1 * toward)
        corners = np.array(flat, np.int32)
        corners[2:, 1] += round(low * drawing.scale)
        cv2.fillConvexPoly(drawing.image, cv2.convexHull(corners), paint)
        cv2.polylines(drawing.image, [cv2.convexHull(corners)], True, paint, thick)
    _decorate(drawing, look, np.array(flat), toward)
    drawing.limb(neck, j["head"], 0.11, 0.11, look.skin)
    drawing.spot(neck, 0.07, look.trim if look.pattern != "plain" else look.shirt)
    _head(drawing, j["head"], look, toward)


def _head(drawing: Drawing, head: Vector, look: Look, toward: float) -> None:
    drawing.spot(head, 0.105, look.skin)
    drawing.spot(head + np.array([0, 0, -0.05]), 0.085, look.skin)
    if look.hair_style == 0:
        return
    lift = 0.045 if toward > 0 else 0.015
    drawing.spot(head + np.array([0, 0, lift + 0.02]), 0.098 + 0.012 * look.hair_style, look.hair)
    if toward > 0:
        drawing.spot(head + np.array([0, 0, -0.03]), 0.08, look.skin)
    if look.hair_style == 3:
        drawing.spot(head + np.array([0, 0, 0.14]), 0.045, look.hair)


def _decorate(drawing: Drawing, look: Look, flat: NDArray[np.int64], toward: float) -> None:
    """Pattern and number on the shirt; `flat` its corners in the drawing."""
    lo, hi = flat.min(0), flat.max(0)
    width, height = int(hi[0] - lo[0]), int(hi[1] - lo[1])
    paint = drawing.rgba(look.trim, 0.1)
    cx = int(lo[0] + hi[0]) // 2
    step = max(3, round(0.09 * drawing.scale))
    if look.pattern == "stripes":
        for k in (-2, 0, 2):
            x = cx + round(k * step * max(width / (0.4 * drawing.scale), 0.35))
            cv2.line(drawing.image, (x, int(lo[1])), (x, int(hi[1])), paint, step)
    elif look.pattern == "hoops":
        pad = round(0.07 * drawing.scale)
        for y in range(int(lo[1]) + step, int(hi[1]), step * 2):
            cv2.line(drawing.image, (int(lo[0]) - pad, y), (int(hi[0]) + pad, y), paint, step)
    elif look.pattern == "sash":
        ends = (int(lo[0]), int(lo[1])), (int(hi[0]), int(hi[1]))
        cv2.line(drawing.image, *ends, paint, step)
    elif look.pattern == "halves" and abs(toward) > 0.5:
        cv2.rectangle(drawing.image, (cx, int(lo[1])), (int(hi[0]), int(hi[1])), paint, -1)
    if look.number and abs(toward) > 0.6:
        big = 1.0 if toward < 0 else 0.55
        size = big * 0.26 * drawing.scale / 22
        thick = max(1, round(big * 0.04 * drawing.scale))
        (w, h), _ = cv2.getTextSize(look.number, cv2.FONT_HERSHEY_SIMPLEX, size, thick)
        y = int(lo[1]) + round(0.48 * height) + h // 2
        ink = drawing.rgba(look.ink, 0.1)
        cv2.putText(
            drawing.image, look.number, (cx - w // 2, y), cv2.FONT_HERSHEY_SIMPLEX, size, ink, thick
        )


def _finish(image: Image, height_px: int, soft_px: float) -> Image:
    """Shrink, round the forms by shading, soften."""
    width_px = round(WIDE_M * height_px / TALL_M)
    small = cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA)
    k = max(3, height_px // 24) | 1
    body = cv2.GaussianBlur(small[..., 3].astype(np.float32) / 255, (k, k), 0)
    shift = max(1, k // 3)
    relief = np.roll(body, -shift, 1) - np.roll(body, shift, 1)
    relief += 0.6 * (np.roll(body, -shift, 0) - np.roll(body, shift, 0))
    light = np.clip(1 + 0.32 * relief + cv2.resize(FOLDS, (width_px, height_px)), 0.5, 1.4)
    lit = cv2.multiply(
        small, cv2.merge([light, light, light, np.ones_like(light)]), dtype=cv2.CV_8U
    )
    return np.asarray(cv2.GaussianBlur(lit, (0, 0), soft_px) if soft_px > 0.2 else lit, np.uint8)
