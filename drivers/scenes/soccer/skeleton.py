"""How people move: gait and phase -> joints in metres.

Fifteen joints in the body's own frame: forward, right, up; the ground at 0.
"""

from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

Joints = dict[str, tuple[float, float, float]]

DIRECTIONS = 12
PHASES = 8
GAITS = ("stand", "walk", "jog", "run", "hold")
_STILL = ("stand", "hold")


@dataclass(frozen=True, kw_only=True)
class Pose:
    """What distinguishes one sprite of a person from another."""

    gait: str
    phase: int  # of PHASES
    direction: int  # of DIRECTIONS; 0 looks to the right of the picture, 1/4 turn: to the camera


@dataclass(frozen=True, kw_only=True)
class Style:
    """A way of moving, angles in radians."""

    swing: float  # of the hips
    knee: float  # most bend
    elbow: float
    lean: float
    bounce_m: float
    aside: float  # how far the arms stand off


STYLES = {
    "stand": Style(swing=0.08, knee=0.1, elbow=0.3, lean=0.03, bounce_m=0.0, aside=0.2),
    "walk": Style(swing=0.42, knee=0.5, elbow=0.4, lean=0.05, bounce_m=0.02, aside=0.16),
    "jog": Style(swing=0.7, knee=1.2, elbow=1.3, lean=0.12, bounce_m=0.04, aside=0.2),
    "run": Style(swing=0.98, knee=1.75, elbow=1.6, lean=0.28, bounce_m=0.06, aside=0.22),
    "hold": Style(swing=0.1, knee=0.1, elbow=1.5, lean=0.06, bounce_m=0.0, aside=0.0),
}


def pose_at(speed_m_s: float, holds: bool, phase: float, turn_rad: float) -> Pose:
    """Return the pose nearest to a speed, a phase in cycles and a turn from the picture's right."""
    gait = "hold" if holds else GAITS[int(np.searchsorted([0.5, 2.2, 4.3], speed_m_s))]
    step = int(phase * PHASES) % PHASES
    return Pose(
        gait=gait,
        phase=step - step % 4 if gait in _STILL else step,
        direction=round(turn_rad / (2 * np.pi) * DIRECTIONS) % DIRECTIONS,
    )


def joints(pose: Pose, tall_m: float, width: float) -> Joints:
    """Return the joints: head, neck, hips, and twice hip knee ankle toe shoulder elbow hand."""
    style = STYLES[pose.gait]
    angle = 2 * np.pi * pose.phase / PHASES
    up = 0.5 * tall_m
    found: Joints = {"hips": (0.0, 0.0, up)}
    for name, side, turn in (("l", -1, angle), ("r", 1, angle + np.pi)):
        found |= _leg(name, side, turn, style, tall_m, 0.09 * width)
    neck = (sin(style.lean) * 0.3 * tall_m, 0.0, up + cos(style.lean) * 0.3 * tall_m)
    found["neck"] = neck
    found["head"] = (neck[0] + 0.04 + 0.06 * style.lean, 0.0, neck[2] + 0.085 * tall_m)
    for name, side, turn in (("l", -1, angle + np.pi), ("r", 1, angle)):
        found |= _arm(name, side, turn, style, pose.gait == "hold", tall_m, neck, 0.2 * width)
    lowest = min(found[k][2] for k in ("anklel", "ankler", "toel", "toer"))
    rise = style.bounce_m * abs(sin(angle)) - lowest + 0.05
    return {k: (p[0], p[1], p[2] + rise) for k, p in found.items()}


def turned(points: Joints, direction: int) -> NDArray[np.float64]:
    """Return joints (n, 3) in the order of `points` as the camera sees them: right, nearer, up."""
    a = 2 * np.pi * direction / DIRECTIONS
    turn = np.array([[cos(a), sin(a), 0], [-sin(a), cos(a), 0], [0, 0, 1]])
    return np.asarray(np.array(list(points.values())) @ turn)


def _leg(name: str, side: int, turn: float, style: Style, tall_m: float, aside_m: float) -> Joints:
    thigh = style.swing * sin(turn) + style.lean * 0.4
    bend = style.knee * max(0.08, 0.5 + 0.5 * cos(turn + 0.5)) ** 1.3
    toe = thigh - bend * 0.8
    hip = (0.0, aside_m * side, 0.5 * tall_m)
    knee = _along(hip, 0.25 * tall_m, thigh, 0.05 * side)
    ankle = _along(knee, 0.23 * tall_m, thigh - bend, 0.02 * side)
    tip = (
        ankle[0] + 0.17 * cos(toe),
        ankle[1] + 0.03 * side,
        ankle[2] + 0.17 * (sin(toe) - 0.25),
    )
    return {"hip" + name: hip, "knee" + name: knee, "ankle" + name: ankle, "toe" + name: tip}


def _arm(
    name: str,
    side: int,
    turn: float,
    style: Style,
    holds: bool,
    tall_m: float,
    neck: tuple[float, float, float],
    aside_m: float,
) -> Joints:
    swing = 0.9 * style.swing * sin(turn) + (0.5 if holds else 0.0)
    away = -0.35 * side if holds else style.aside * side
    shoulder = (neck[0], neck[1] + aside_m * side, neck[2] - 0.05 * tall_m)
    elbow = _along(shoulder, 0.165 * tall_m, swing, away)
    hand = _along(elbow, 0.17 * tall_m, swing + style.elbow, away * 0.6)
    return {"shoulder" + name: shoulder, "elbow" + name: elbow, "hand" + name: hand}


def _along(
    start: tuple[float, float, float], length: float, forward: float, aside: float
) -> tuple[float, float, float]:
    """Return the end of a limb that hangs down, swung forward and aside by angles."""
    return (
        start[0] + length * sin(forward),
        start[1] + length * sin(aside),
        start[2] - length * cos(forward) * cos(aside),
    )
