"""Paths of the objects: a seed and times -> where everybody is, without end.

Each coordinate is the sum of two slow sine waves with periods of its own. That is smooth, stays
inside the field, and is known for any time without the times before.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Range = tuple[float, float]

PEOPLE_S: tuple[Range, Range] = ((40.0, 90.0), (18.0, 32.0))  # periods of both waves, seconds
BALL_S: tuple[Range, Range] = ((24.0, 40.0), (12.0, 20.0))
SHARES = (0.7, 0.3)  # of the reach, by wave


@dataclass(frozen=True, kw_only=True, eq=False)
class Paths:
    """Paths of n objects; the arrays are (n, axis, wave) but for `middle`."""

    middle: Points  # (n, 2), share of the room
    reach: Points  # share of the room
    period_s: Points
    shift: Points  # radians

    def at(self, time_s: float) -> tuple[Points, Points]:
        """Return places and velocities per second: (n, 2) each, in shares of the room, 0..1."""
        turn = 2 * np.pi / self.period_s
        angle = turn * time_s + self.shift
        place = self.middle + (self.reach * np.sin(angle)).sum(-1)
        return place, (self.reach * turn * np.cos(angle)).sum(-1)


def draw_paths(seed: int, people: int) -> Paths:
    """Draw the paths of the ball, first, and of so many people; each is the same for any number."""
    drawn = [_draw(np.random.default_rng([seed, 32, n]), n == 0) for n in range(people + 1)]
    middle, reach, period_s, shift = (np.array(parts) for parts in zip(*drawn, strict=True))
    return Paths(middle=middle, reach=reach, period_s=period_s, shift=shift)


def _draw(rng: np.random.Generator, is_ball: bool) -> tuple[Points, Points, Points, Points]:
    """Return middle, reach, periods and shifts of one object."""
    extent = rng.uniform(0.55, 1.0, 2)  # share of the room that the path spans
    low, high = np.array(BALL_S if is_ball else PEOPLE_S).T
    return (
        extent / 2 + rng.random(2) * (1 - extent),
        extent[:, None] / 2 * np.array(SHARES),
        rng.uniform(low, high, (2, 2)),
        rng.uniform(0, 2 * np.pi, (2, 2)),
    )
