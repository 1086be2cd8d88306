"""Path of the ball: a seed and a time -> position and height, without end.

Time is divided into chunks. The ball's position between two chunks depends only on the seed, so
that any chunk can be computed without its predecessors.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.camera import PITCH_M

CHUNK_S = 10.0
GRAVITY = 9.81
FIRST = 16  # offset of chunks in seeds, because chunks before the first frame are negative
HELD_M = 1.15
RADIUS_M = 0.11

Metres = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Leg:
    """One part of the ball's path, of one kind."""

    kind: str  # still | carry | pass | lob | held
    start_s: float
    end_s: float
    start_m: tuple[float, float]
    end_m: tuple[float, float]
    team: int  # whose ball it is
    rise_m: float = 0.0  # height at the start


@dataclass(frozen=True, kw_only=True)
class Knot:
    """The boundary of two chunks, and how the second begins."""

    kind: str  # open | corner | keeper | free
    place_m: tuple[float, float]
    team: int


@lru_cache(maxsize=64)
def knot(seed: int, chunk: int) -> Knot:
    """Return the start of a chunk: (seed, chunk) -> place and kind."""
    rng = np.random.default_rng([seed, 1, chunk + FIRST])
    kind = str(rng.choice(["open", "corner", "keeper", "free"], p=[0.55, 0.15, 0.14, 0.16]))
    swing = 32 * np.sin(2 * np.pi * (chunk / 9.3 + seed % 97 / 97))
    x = float(np.clip(52.5 + swing + rng.normal(0, 7), 4, 101))
    y = float(rng.uniform(12, 56))
    end = 0.0 if x < PITCH_M[0] / 2 else PITCH_M[0]
    team = int(rng.integers(2))
    if kind == "corner":
        x, y = abs(end - 0.4), 0.4 if rng.random() < 0.5 else PITCH_M[1] - 0.4
        team = 0 if end else 1
    elif kind == "keeper":
        x, y = abs(end - rng.uniform(3, 10)), 34 + rng.uniform(-6, 6)
        team = 1 if end else 0
    return Knot(kind=kind, place_m=(x, y), team=team)


@lru_cache(maxsize=64)
def legs(seed: int, chunk: int) -> tuple[Leg, ...]:
    """Return the legs of one chunk, without gaps, from its knot to the next."""
    rng = np.random.default_rng([seed, 2, chunk + FIRST])
    begin, end = knot(seed, chunk), knot(seed, chunk + 1)
    kinds, durations = _timetable(begin.kind, rng)
    places = _places(begin.place_m, end, kinds, durations, rng)
    times = chunk * CHUNK_S + np.concatenate([[0.0], np.cumsum(durations)])
    made: list[Leg] = []
    team = begin.team
    for i, kind in enumerate(kinds):
        if kind == "carry" and rng.random() < 0.25:
            team = 1 - team
        a, b = places[i], places[i + 1]
        if kind == "pass" and np.hypot(*(b - a)) > 14 and rng.random() < 0.45:
            kind = "lob"
        rise = HELD_M if i and kinds[i - 1] == "held" else 0.0
        made.append(
            Leg(
                kind=kind,
                start_s=float(times[i]),
                end_s=float(times[i + 1]),
                start_m=(float(a[0]), float(a[1])),
                end_m=(float(b[0]), float(b[1])),
                team=team,
                rise_m=rise,
            )
        )
    return tuple(made)


def _timetable(kind: str, rng: np.random.Generator) -> tuple[list[str], Metres]:
    """Return kinds and durations (seconds, together one chunk) of the legs."""
    kinds: list[str] = []
    durations: list[float] = []
    if kind != "open":
        kinds = ["held" if kind == "keeper" else "still"]
        durations = [float(rng.uniform(2.5, 6.5))]
        kinds += ["pass"]
        durations += [float(rng.uniform(1.2, 2.2))]
    while sum(durations) < CHUNK_S - 1.5:
        kinds += ["carry", "pass"]
        durations += [float(rng.uniform(0.5, 2.6)), float(rng.uniform(0.7, 1.7))]
    fixed = durations[0] if kind != "open" else 0.0
    free = np.array(durations)
    free[1 if fixed else 0 :] *= (CHUNK_S - fixed) / (free.sum() - fixed)
    return kinds, free


def _places(
    start: tuple[float, float],
    end: Knot,
    kinds: list[str],
    durations: Metres,
    rng: np.random.Generator,
) -> Metres:
    """Return where the legs begin and end: a random walk from knot to knot, (n + 1, 2)."""
    pace = np.array([{"still": 0.0, "held": 0.0, "carry": 2.2}.get(k, 9.0) for k in kinds])
    ways = pace * durations
    share = np.concatenate([[0.0], np.cumsum(ways) / ways.sum()])
    a, b = np.array(start), np.array(end.place_m)
    stray = np.cumsum(rng.normal(0, 1, (len(kinds), 2)) * ways[:, None] * 0.38, 0)
    stray = np.concatenate([np.zeros((1, 2)), stray])
    stray -= share[:, None] * stray[-1]
    places = a + share[:, None] * (b - a) + stray
    places[1:-1] = np.clip(places[1:-1], [1.5, 1.5], [PITCH_M[0] - 1.5, PITCH_M[1] - 1.5])
    if kinds[0] in ("still", "held"):
        places[1] = a
    return np.asarray(places)


def leg_points(leg: Leg, times: Metres) -> Metres:
    """Return the ball's centre at times (n,) within the leg: (n, 3), metres."""
    u = np.clip((times - leg.start_s) / (leg.end_s - leg.start_s), 0, 1)
    duration = leg.end_s - leg.start_s
    along, height = u, np.zeros_like(u)
    if leg.kind == "pass":
        along = (1 - np.exp(-1.1 * u)) / (1 - np.exp(-1.1))
        length = np.hypot(leg.end_m[0] - leg.start_m[0], leg.end_m[1] - leg.start_m[1])
        height = _hops(u, min(length * 0.012, 0.35), (0.3, 0.3, 0.25))
    elif leg.kind == "lob":
        along = np.where(u < 0.75, u * 1.12, 0.84 + (u - 0.75) * 0.64)
        height = _hops(u, GRAVITY * (0.75 * duration) ** 2 / 8, (0.75, 0.17, 0.08))
    elif leg.kind == "carry":
        touches = max(1, round(duration / 0.6))
        along = u - 0.7 * np.sin(2 * np.pi * touches * u) / (2 * np.pi * touches)
    elif leg.kind == "held":
        height = np.full_like(u, HELD_M)
    fall = leg.rise_m * np.clip(1 - u / 0.35, 0, 1) ** 2
    start, end = np.array(leg.start_m), np.array(leg.end_m)
    ground = start + along[:, None] * (end - start)
    return np.column_stack([ground, RADIUS_M + height + fall])


def _hops(u: Metres, top_m: float, lengths: tuple[float, ...]) -> Metres:
    """Return heights of a flight and its bounces, which take these shares of the leg."""
    height = np.zeros_like(u)
    begun = 0.0
    for length in lengths:
        inside = (u >= begun) & (u < begun + length)
        v = (u - begun) / length
        height = np.where(inside, 4 * top_m * (length / lengths[0]) ** 2 * v * (1 - v), height)
        begun += length
    return height


def ball_points(seed: int, times: Metres) -> Metres:
    """Return the ball's centre at ascending times (n,): (n, 3), metres."""
    points = np.empty((len(times), 3))
    for chunk in range(int(times[0] // CHUNK_S), int(times[-1] // CHUNK_S) + 1):
        for leg in legs(seed, chunk):
            inside = (times >= leg.start_s) & (times < leg.end_s)
            if inside.any():
                points[inside] = leg_points(leg, times[inside])
    return points
