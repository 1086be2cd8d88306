"""Simulate the play: a seed and a chunk of time -> paths of ball, people and camera focus."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from drivers.scenes.soccer.ball_path import CHUNK_S, FIRST, Leg, Metres, ball_points, legs
from drivers.scenes.soccer.camera import PITCH_M

GRID_HZ = 30.0
MARGIN_S = 4.0
RAMP_S = 7.0  # longest approach of a person to the ball; less than a chunk
PACE_M_S = 4.0
STRIDE_M = 2.3  # ground covered by one full cycle of the legs when running
LABELS = (
    *("player",) * 20,
    *("goalkeeper",) * 2,
    "main referee",
    *("assistant referee",) * 2,
)
KEEPERS = (20, 21)
REFEREE = 22
ASSISTANTS = (23, 24)
# 4-4-2 as shares of the block's length and width, rearmost first
SLOTS = np.array(
    [
        *((0, 0.12), (0, 0.37), (0, 0.63), (0, 0.88)),
        *((0.45, 0.08), (0.4, 0.38), (0.5, 0.62), (0.5, 0.92)),
        *((0.9, 0.35), (1, 0.62)),
    ]
)


@dataclass(frozen=True, kw_only=True)
class Duty:
    """One person who is at the ball during a leg, or after it."""

    leg: Leg
    who: int
    gap_m: float  # closest distance to the ball
    pull: float  # weight of the approach, 0..1
    come_s: float  # start of the approach before the leg
    leave_s: float


@dataclass(frozen=True, kw_only=True)
class Moment:
    """One instant of the play."""

    ball: Metres  # (3,) metres
    ball_kind: str  # as Leg.kind
    people: Metres  # (25, 2) metres
    heading: Metres  # (25,) radians, 0 along x
    speed: Metres  # (25,) m/s
    phase: Metres  # (25,) cycles of the legs, mod 1
    carrier: int  # index of the person holding the ball; -1: none
    focus: Metres  # (2,) metres, where the camera should look


@dataclass(frozen=True, kw_only=True, eq=False)
class Chunk:
    """The paths within one chunk, on a regular grid of n instants with both ends."""

    start_s: float
    ball: Metres  # (n, 3)
    people: Metres  # (n, 25, 2)
    heading: Metres  # (n, 25)
    speed: Metres  # (n, 25)
    phase: Metres  # (n, 25), cycles, not wrapped
    focus: Metres  # (n, 2)


def grid(chunk: int, margin_s: float = 0.0) -> Metres:
    """Return the instants of a chunk, with `margin_s` more at both ends."""
    start = chunk * CHUNK_S
    extra = round(margin_s * GRID_HZ)
    return start + np.arange(-extra, round(CHUNK_S * GRID_HZ) + 1 + extra) / GRID_HZ


def smoothed(values: Metres, before_s: float, after_s: float) -> Metres:
    """Return the mean of (n, c) over [t - before, t + after], for each t with a whole window."""
    b, a = round(before_s * GRID_HZ), round(after_s * GRID_HZ)
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, 0)])
    width = a + b + 1
    return np.asarray((total[width:] - total[:-width]) / width)


@lru_cache(maxsize=24)
def base_paths(seed: int, chunk: int) -> Metres:
    """Return where the people would be if nobody went for the ball: (n, 25, 2)."""
    times = grid(chunk)
    slow = smoothed(ball_points(seed, grid(chunk, MARGIN_S))[:, :2], MARGIN_S, MARGIN_S)
    rng = np.random.default_rng([seed, 3])
    out = np.empty((len(times), 25, 2))
    near_end = np.clip(1 - (np.minimum(slow[:, 0], PITCH_M[0] - slow[:, 0]) / 24), 0, 1)[:, None]
    for team in range(2):
        sign = 1 if team == 0 else -1
        stray = rng.normal(0, [2.5, 3.0], (10, 2))
        along = (SLOTS[:, 0] - 0.5) * 28 * (1 - 0.5 * near_end)
        across = (SLOTS[:, 1] - 0.5) * 35 * (1 - 0.45 * near_end)
        middle_x = 52.5 + 0.82 * (slow[:, :1] - 52.5) - sign * 5
        middle_y = 34 + 0.55 * (1 - 0.7 * near_end) * (slow[:, 1:] - 34)
        out[:, team * 10 : team * 10 + 10, 0] = middle_x + sign * along + stray[:, 0]
        out[:, team * 10 : team * 10 + 10, 1] = middle_y + sign * across + stray[:, 1]
        goal_x = 3.5 if team == 0 else PITCH_M[0] - 3.5
        out[:, 20 + team, 0] = goal_x + 0.1 * (slow[:, 0] - goal_x)
        out[:, 20 + team, 1] = 34 + 0.12 * (slow[:, 1] - 34)
    out[:, REFEREE] = slow * 0.9 + np.array([5.0, 3.4]) + np.array([0.0, 7.0])
    out[:, ASSISTANTS[0], 0] = np.clip(slow[:, 0] * 0.8 - 6, 0, 52)
    out[:, ASSISTANTS[1], 0] = np.clip(slow[:, 0] * 0.8 + 27, 53, 105)
    out[:, ASSISTANTS[0], 1] = -0.8
    out[:, ASSISTANTS[1], 1] = PITCH_M[1] + 0.8
    wander = _wander(rng, times)
    wander[:, ASSISTANTS, 1] *= 0.05
    out += wander * np.where(np.isin(np.arange(25), KEEPERS), 0.4, 1.0)[:, None]
    low, high = np.array([0.7, 0.7]), np.array(PITCH_M) - 0.7
    out[:, :23] = np.clip(out[:, :23], low, high)
    return out


def _wander(rng: np.random.Generator, times: Metres) -> Metres:
    """Return random movements of each person: (n, 25, 2), metres."""
    period = rng.uniform(5, 19, (3, 25, 2))
    shift = rng.uniform(0, 2 * np.pi, (3, 25, 2))
    wave = np.sin(2 * np.pi * times[:, None, None, None] / period + shift)
    return np.asarray((wave * np.array([1.6, 1.0, 0.7])[:, None, None]).sum(1))


@lru_cache(maxsize=24)
def duties(seed: int, chunk: int) -> tuple[Duty, ...]:
    """Return who has the ball and who goes for it, in a chunk's legs in which anyone has it."""
    base = base_paths(seed, chunk)
    found: list[Duty] = []
    last = -1
    for leg in legs(seed, chunk):
        if leg.kind not in ("carry", "held", "still"):
            continue
        first, final = (
            base[round((t - chunk * CHUNK_S) * GRID_HZ)] for t in (leg.start_s, leg.end_s)
        )
        come = np.hypot(*(first - np.array(leg.start_m)).T)
        leave = np.hypot(*(final - np.array(leg.end_m)).T)
        near = come[:20] + 6 * (np.arange(20) == last)  # who just passed the ball leaves it
        own = np.arange(10) + leg.team * 10
        other = np.arange(10) + 10 - leg.team * 10
        last = int(own[near[own].argmin()])
        if leg.kind == "held":
            last = KEEPERS[0 if leg.start_m[0] < PITCH_M[0] / 2 else 1]
        crew = [(last, 0.1 if leg.kind == "held" else 0.45, 1.0)]
        if leg.kind == "carry":
            crew.append((int(other[near[other].argmin()]), 1.3, 0.9))
        for who, gap_m, pull in crew:
            ramps = (float(np.clip(way[who] / PACE_M_S, 0.8, RAMP_S)) for way in (come, leave))
            come_s, leave_s = ramps
            found.append(
                Duty(leg=leg, who=who, gap_m=gap_m, pull=pull, come_s=come_s, leave_s=leave_s)
            )
    return tuple(found)


def _pulled(seed: int, chunk: int, base: Metres) -> Metres:
    """Return the base paths, bent so that those who have the ball are where it is.

    Overlapping pulls are weighted by their squares, so that nobody jumps.
    """
    times = grid(chunk)
    bend, total = np.zeros_like(base), np.full(base.shape[:2], 1e-9)
    strongest = np.zeros(base.shape[:2])
    for near in (chunk - 1, chunk, chunk + 1):
        for duty in duties(seed, near):
            leg, who = duty.leg, duty.who
            early, late = (leg.start_s - times) / duty.come_s, (times - leg.end_s) / duty.leave_s
            w = np.clip(1 - np.maximum(early, late), 0, 1)
            if not w.any():
                continue
            w = duty.pull * w * w * (3 - 2 * w)
            share = np.clip((times - leg.start_s) / (leg.end_s - leg.start_s), 0, 1)
            ball = np.array(leg.start_m) + share[:, None] * np.subtract(leg.end_m, leg.start_m)
            way = base[:, who] - ball
            reach = np.linalg.norm(way, axis=1, keepdims=True) + 1e-6
            to_target = way / reach * np.minimum(duty.gap_m, reach) - way
            bend[:, who] += w[:, None] ** 2 * to_target
            total[:, who] += w**2
            strongest[:, who] = np.maximum(strongest[:, who], w)
    return np.asarray(base + bend / total[..., None] * strongest[..., None])


@lru_cache(maxsize=12)
def raw_people(seed: int, chunk: int) -> Metres:
    """Return where the people are, before their paths are smoothed: (n, 25, 2)."""
    return _pulled(seed, chunk, base_paths(seed, chunk))


@lru_cache(maxsize=6)
def make_chunk(seed: int, chunk: int, lag_s: float) -> Chunk:
    """Return all paths of one chunk, in some milliseconds; they do not depend on other calls."""
    n = round(CHUNK_S * GRID_HZ)
    row = np.concatenate(
        [raw_people(seed, c)[: n if c <= chunk else n + 1] for c in (chunk - 1, chunk, chunk + 1)]
    )
    flat = smoothed(row.reshape(len(row), -1), 0.25, 0.25)
    lead = round(0.25 * GRID_HZ)
    people = flat[n - lead - 1 : 2 * n - lead + 2].reshape(-1, 25, 2)
    velocity = (people[2:] - people[:-2]) * GRID_HZ / 2
    people = people[1:-1]
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    around = ball_points(seed, grid(chunk, MARGIN_S))
    focus = smoothed(around[:, :2], lag_s + 0.9, 0.9 - lag_s * 0.5)
    skip = round(MARGIN_S * GRID_HZ) - round((lag_s + 0.9) * GRID_HZ)
    focus = smoothed(focus[skip - 8 : skip + n + 9], 8 / GRID_HZ, 8 / GRID_HZ)
    margin = round(MARGIN_S * GRID_HZ)
    ball = around[margin : margin + n + 1]
    return Chunk(
        start_s=chunk * CHUNK_S,
        ball=ball,
        people=people,
        heading=_headings(people, velocity, speed, ball),
        speed=speed,
        phase=_phases(seed, chunk, speed),
        focus=focus,
    )


def _headings(people: Metres, velocity: Metres, speed: Metres, ball: Metres) -> Metres:
    """Return headings: runners look where they run, the others at the ball: (n, 25), radians."""
    to_ball = ball[:, None, :2] - people
    to_ball /= np.linalg.norm(to_ball, axis=-1, keepdims=True) + 1e-6
    run = np.clip((speed - 0.8) / 1.5, 0, 1)[..., None]
    way = to_ball * (1 - run) + run * velocity / np.maximum(speed, 0.1)[..., None]
    return np.asarray(np.arctan2(way[..., 1], way[..., 0]))


def _phases(seed: int, chunk: int, speed: Metres) -> Metres:
    """Return cycles of the legs, continuous from chunk to chunk: (n, 25)."""
    step = np.minimum(speed, 9) / (0.9 + STRIDE_M * np.clip(speed / 5, 0, 1)) / GRID_HZ
    done = np.cumsum(step, 0) - step[0]
    first, last = (
        np.random.default_rng([seed, 4, c + FIRST]).random(25) for c in (chunk, chunk + 1)
    )
    wanted = np.round(done[-1] + first - last) + last - first
    ramp = np.linspace(0, 1, len(speed))[:, None]
    return np.asarray(first + done + ramp * (wanted - done[-1]))


def _between(values: Metres, row: int, share: float) -> Metres:
    """Return the values at a share of the way from one row to the next."""
    return np.asarray(values[row] * (1 - share) + values[row + 1] * share)


def moment(seed: int, time_s: float, lag_s: float) -> Moment:
    """Return the play at one instant from 0 on."""
    chunk = int(time_s // CHUNK_S)
    paths = make_chunk(seed, chunk, lag_s)
    at = (time_s - paths.start_s) * GRID_HZ
    i = min(int(at), len(paths.ball) - 2)
    f = at - i
    leg = next((g for g in legs(seed, chunk) if time_s < g.end_s), legs(seed, chunk)[-1])
    carrier = KEEPERS[0 if leg.start_m[0] < PITCH_M[0] / 2 else 1] if leg.kind == "held" else -1
    return Moment(
        ball=ball_points(seed, np.array([time_s]))[0],
        ball_kind=leg.kind,
        people=_between(paths.people, i, f),
        heading=paths.heading[i if f < 0.5 else i + 1],
        speed=_between(paths.speed, i, f),
        phase=_between(paths.phase, i, f) % 1.0,
        carrier=carrier,
        focus=_between(paths.focus, i, f),
    )
