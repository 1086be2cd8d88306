"""Where the camera stands: a view and a picture's size -> a place from which all is in the picture.

The camera's own frame of reference is that of `soccer.camera`: x to the right along the far line,
y from the far line to the camera, z up. From behind a goal it is turned by a quarter: x along the
goal lines, y from the far goal line to the near one.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.camera import PITCH_M, Points, Station, View
from drivers.scenes.soccer.play import Moment

VIEWS = ("main", "behind_goal")
BACK_M = {"main": (38.0, 43.0), "behind_goal": (46.0, 52.0)}  # from the near line to the mast
MARGIN_M = 3.0  # of ground around the pitch that is in the picture, with the people on it
TALL_M = 2.4
HEIGHT_M = 12.0, 42.0
ABOVE = 0.7  # share of the spare height above the pitch: the stand
FILLED = 0.97


@dataclass(frozen=True, kw_only=True)
class Mast:
    """A still camera."""

    view: View
    turned: bool  # behind a goal
    field_m: tuple[float, float]  # the pitch in the camera's frame: across, deep

    def seen(self, points: Points) -> Points:
        """Return points (..., 2 or 3) of the pitch in the camera's frame, metres."""
        if not self.turned:
            return points
        rest = points[..., 2:]
        return np.concatenate([points[..., 1:2], PITCH_M[0] - points[..., :1], rest], -1)

    def moment(self, now: Moment) -> Moment:
        """Return an instant of the play in the camera's frame."""
        if not self.turned:
            return now
        return replace(
            now,
            ball=self.seen(now.ball),
            people=self.seen(now.people),
            heading=now.heading - np.pi / 2,
        )


def place(rng: np.random.Generator, view: str, size_px: tuple[int, int]) -> Mast:
    """Return a mast from which a picture of this size shows all of the pitch.

    The width of the pitch fills the picture's, unless the picture is so wide that its height is
    what limits. The higher the picture in proportion, the higher the mast, up to `HEIGHT_M`.
    """
    turned = view == "behind_goal"
    field_m = (PITCH_M[1], PITCH_M[0]) if turned else PITCH_M
    x_m = field_m[0] / 2 + float(rng.uniform(-2, 2))
    y_m = field_m[1] + float(rng.uniform(*BACK_M[view]))
    station = Station(x_m=x_m, y_m=y_m, height_m=1.0)
    edge = _edge(field_m)
    bearings = station.angles(edge)[:, 0]
    widest = (bearings.max() - bearings.min()) * 1.02
    # the drop of a point of the ground is height / reach: the height that fills the picture
    reach = station.distance_m(edge)
    fill = FILLED * size_px[1] / size_px[0] * widest
    wanted = (fill - TALL_M / reach.max()) / (1 / reach.min() - 1 / reach.max())
    height = float(np.clip(wanted, *HEIGHT_M)) * float(rng.uniform(0.94, 1.0))
    station = replace(station, height_m=height)
    return Mast(view=_view(station, edge, size_px), turned=turned, field_m=field_m)


def _view(station: Station, edge: Points, size_px: tuple[int, int]) -> View:
    """Aim and zoom so that the edge of the pitch, and people on it, are in the picture."""
    angles = np.concatenate([station.angles(edge), station.angles(edge + np.array([0, 0, TALL_M]))])
    low, high = angles.min(0), angles.max(0)
    spans = (high - low) * 1.02
    radius = min(size_px[0] / spans[0], size_px[1] / spans[1])
    spare = size_px[1] / radius - (high[1] - low[1])
    middle = (low + high) / 2
    drop = low[1] - spare * ABOVE + size_px[1] / radius / 2
    if spare < 0.1 * spans[1]:
        drop = middle[1]
    return View(
        station=station,
        aim=(float(middle[0]), float(drop)),
        radius_px=float(radius),
        roll_rad=0.0,
        size_px=size_px,
    )


def _edge(field_m: tuple[float, float]) -> NDArray[np.float64]:
    """Return points around the pitch and its margin: (n, 3), metres."""
    share = np.linspace(0, 1, 65)
    x, y = (share * (side + 2 * MARGIN_M) - MARGIN_M for side in field_m)
    zero = np.zeros_like(share)
    sides = [(x, zero + y[0]), (x, zero + y[-1]), (zero + x[0], y), (zero + x[-1], y)]
    flat = np.concatenate([np.column_stack(side) for side in sides])
    return np.column_stack([flat, np.zeros(len(flat))])
