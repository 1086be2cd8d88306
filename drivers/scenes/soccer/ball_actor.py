"""Place the ball in a frame: play and views while the shutter is open -> an `Actor`."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer import ball
from drivers.scenes.soccer.blend import extent
from drivers.scenes.soccer.camera import View
from drivers.scenes.soccer.play import Moment
from drivers.scenes.soccer.stage import BALL_ID, Actor

BALL_M = 0.222


def ball_point(now: Moment) -> NDArray[np.float64]:
    """Return where the ball is; a held one is before its carrier's chest."""
    if now.carrier < 0:
        return now.ball
    turn = now.heading[now.carrier]
    reach = 0.3 * np.array([np.cos(turn), np.sin(turn)])
    return np.array([*(now.people[now.carrier] + reach), now.ball[2]])


def ball_actor(
    at_end: tuple[Moment, View],
    opened: tuple[Moment, View],
    discs: Sequence[NDArray[np.uint8]],
    seed: int,
) -> Actor:
    """Draw the ball's movement while the shutter is open, which ends at the frame's time.

    `discs` are its sides (`ball.discs`); `seed` tells which of them comes first.
    """
    now, view = at_end
    start, end = ball_point(opened[0]), ball_point(now)
    a, b = opened[1].pixels(start), view.pixels(end)
    scale = float(view.px_per_m(end))
    rolled = int(float(now.ball[0]) / 0.35 * ball.ROLLS / 2 + seed) % ball.ROLLS
    patch, left, top = ball.streak(
        discs[rolled],
        BALL_M * scale,
        (float(a[0]), float(a[1])),
        (float(b[0]), float(b[1])),
    )
    solid = max(1, min(100, int(patch[..., 3].max()) // 2))  # a fast ball is almost transparent
    x0, y0, x1, y1 = extent(patch[..., 3], solid)
    on_ground = view.pixels(end * np.array([1, 1, 0]))
    return Actor(
        id=BALL_ID,
        label="ball",
        patch=patch,
        left=left,
        top=top,
        box=(left + x0, top + y0, left + x1, top + y1),
        nearer=-float(view.station.distance_m(end)),
        ground=(float(on_ground[0]), float(on_ground[1])),
        scale=scale,
        solid=solid,
    )
