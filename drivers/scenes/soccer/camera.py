"""Projection of the world into the picture: metres -> angles on a cylinder -> pixels.

The camera stands beside the pitch and turns; its picture is a piece of a cylinder around it, so
that pan, tilt, zoom and roll are one affine map and people stay upright. World: x along the far
touch line, y from the far to the near one, z up, all in metres, origin in the far left corner.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

PITCH_M = (105.0, 68.0)


@dataclass(frozen=True, kw_only=True)
class Station:
    """Where the camera stands."""

    x_m: float
    y_m: float
    height_m: float

    def angles(self, points: Points) -> Points:
        """Return bearing in radians, drop below the horizon per distance: (..., 3) -> (..., 2)."""
        reach = np.hypot(points[..., 0] - self.x_m, self.y_m - points[..., 1])
        bearing = np.arctan2(points[..., 0] - self.x_m, self.y_m - points[..., 1])
        return np.stack([bearing, (self.height_m - points[..., 2]) / reach], -1)

    def distance_m(self, points: Points) -> Points:
        """Return the horizontal distance of points (..., 2 or 3): (...), metres."""
        return np.asarray(np.hypot(points[..., 0] - self.x_m, self.y_m - points[..., 1]))

    def ground(self, angles: Points) -> Points:
        """Return the ground point seen at angles (..., 2) below the horizon: (..., 2), metres."""
        reach = self.height_m / angles[..., 1]
        x = self.x_m + reach * np.sin(angles[..., 0])
        return np.stack([x, self.y_m - reach * np.cos(angles[..., 0])], -1)


@dataclass(frozen=True, kw_only=True)
class View:
    """The camera's aim, zoom and roll in one frame."""

    station: Station
    aim: tuple[float, float]  # angles in the middle of the picture
    radius_px: float  # pixels per radian
    roll_rad: float
    size_px: tuple[int, int]

    def matrix(self) -> Points:
        """Return the affine map (2, 3) from angles to pixels."""
        c, s = np.cos(self.roll_rad), np.sin(self.roll_rad)
        turn = self.radius_px * np.array([[c, -s], [s, c]])
        middle = np.array(self.size_px, float) / 2
        return np.column_stack([turn, middle - turn @ np.array(self.aim)])

    def pixels(self, points: Points) -> Points:
        """Project points: (..., 3) metres -> (..., 2) pixels."""
        m = self.matrix()
        return np.asarray(self.station.angles(points) @ m[:, :2].T + m[:, 2])

    def px_per_m(self, points: Points) -> Points:
        """Return the pixels of one upright metre at points (..., 3): (...)."""
        return self.radius_px / self.station.distance_m(points)


@dataclass(frozen=True, kw_only=True)
class CameraStyle:
    """The style of a broadcast: zoom, lag, jitter and roll."""

    px_per_m: float  # at the middle of the pitch, for a picture 1920 wide
    zoom_swing: float  # relative
    zoom_period_s: float
    lag_s: float
    jitter_rad: float
    roll_rad: float


def draw_station(rng: np.random.Generator) -> Station:
    """Draw a usual place for a main camera: beside the halfway line, on the stand."""
    return Station(
        x_m=PITCH_M[0] / 2 + rng.uniform(-6, 6),
        y_m=PITCH_M[1] + rng.uniform(23, 38),
        height_m=rng.uniform(9.5, 16),
    )


def draw_style(rng: np.random.Generator) -> CameraStyle:
    """Draw a usual style."""
    return CameraStyle(
        px_per_m=rng.uniform(43, 74),
        zoom_swing=rng.uniform(0.05, 0.25),
        zoom_period_s=rng.uniform(15, 45),
        lag_s=rng.uniform(0.4, 1.2),
        jitter_rad=rng.uniform(0.0, 0.0012),
        roll_rad=rng.uniform(-0.02, 0.02),
    )


def zoom(size_px: tuple[int, int]) -> float:
    """Return the scale relative to full HD, so that no picture shape shows more height."""
    return max(size_px[0] / 1920, size_px[1] / 1080)


def lowest_drop(station: Station) -> float:
    """Return the greatest drop that the camera shows straight ahead."""
    return station.height_m / (station.y_m - PITCH_M[1] - 4)


def view_at(
    station: Station, style: CameraStyle, size_px: tuple[int, int], focus: Points, time_s: float
) -> View:
    """Return the view that keeps `focus` (2,), a point of the ground in metres, in the picture."""
    reach = float(station.distance_m(focus))
    usual = station.y_m - PITCH_M[1] / 2
    swing = 1 + style.zoom_swing * np.sin(2 * np.pi * time_s / style.zoom_period_s)
    # near objects are zoomed out, but by less than they come nearer
    radius = style.px_per_m * usual**0.35 * reach**0.65 * swing * zoom(size_px)
    bearing, drop = station.angles(np.array([focus[0], focus[1], 0.0]))
    shake = np.sin(time_s * np.array([7.3, 9.1]) + np.sin(time_s * np.array([2.9, 3.7])) * 2)
    half_w, half_h = size_px[0] / 2 / radius, size_px[1] / 2 / radius
    lowest = lowest_drop(station) - half_h - abs(style.roll_rad) * half_w
    widest = np.arctan2(PITCH_M[0] / 2 + 8, usual) - half_w * 0.6
    return View(
        station=station,
        aim=(
            float(np.clip(bearing, -widest, widest) + style.jitter_rad * shake[0]),
            float(
                np.clip(drop - 0.08 * half_h, half_h * 0.55, lowest) + style.jitter_rad * shake[1]
            ),
        ),
        radius_px=float(radius),
        roll_rad=style.roll_rad,
        size_px=size_px,
    )
