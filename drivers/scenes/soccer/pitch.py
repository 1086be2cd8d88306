"""Draw the static world: pitch, lines, goals, flags, stands -> one wide canvas.

The canvas is a piece of the camera's cylinder; row and column are linear in its angles.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.camera import PITCH_M, Points, Station, lowest_drop
from drivers.scenes.soccer.looks import Colour
from drivers.scenes.soccer.stadium import WALL_M, WALL_PX_PER_M, wall

Image = NDArray[np.uint8]

BEARINGS = (-1.12, 1.12)  # radians
LINE_M = 0.12
BEHIND_M = 5.0  # from the touch and goal lines to the billboards
GOAL_M = (7.32, 2.44)
SHIFT = 4  # binary digits of sub-pixel positions in OpenCV's drawing


@dataclass(frozen=True, kw_only=True, eq=False)
class Canvas:
    """The static world: pixel (0, 0) is at `origin`, one pixel is 1 / radius_px radians."""

    image: Image  # (h, w, 3), or 4 with an unused fourth: twice as fast to warp
    origin: tuple[float, float]  # bearing, drop
    radius_px: float
    grass: Colour

    def pixels(self, angles: Points) -> Points:
        """Map angles (..., 2) to canvas pixels (..., 2)."""
        return np.asarray((angles - np.array(self.origin)) * self.radius_px)


@dataclass(frozen=True, kw_only=True)
class Turf:
    """The appearance of the grass."""

    colour: Colour
    stripe_m: float
    stripe: float  # relative brightness step
    pattern: str  # across | along | checks | none
    noise: float
    line: float  # brightness of the lines, 0..1


def draw_turf(rng: np.random.Generator, tint: Points) -> Turf:
    """Draw a usual turf: artificial and bright, or worn and dull."""
    green = rng.uniform(95, 160)
    base = np.array([green * rng.uniform(0.55, 0.9), green, green * rng.uniform(0.25, 0.65)]) * tint
    return Turf(
        colour=(int(base[0]), int(base[1]), int(base[2])),
        stripe_m=float(rng.choice([3.0, 5.25, 5.5, 7.0, 11.0])),
        stripe=float(rng.uniform(0.015, 0.13)),
        pattern=str(rng.choice(["across", "across", "along", "checks", "none"])),
        noise=float(rng.uniform(3, 11)),
        line=float(rng.uniform(0.6, 1.0)),
    )


def draw_canvas(
    rng: np.random.Generator, station: Station, turf: Turf, radius_px: float, light: float
) -> Canvas:
    """Draw the static world as the camera sees it, with `radius_px` pixels per radian."""
    sky = -0.2
    span = BEARINGS[1] - BEARINGS[0], lowest_drop(station) - sky
    size = round(span[0] * radius_px), round(span[1] * radius_px)
    canvas = Canvas(
        image=np.empty((size[1], size[0], 3), np.uint8),
        origin=(BEARINGS[0], sky),
        radius_px=radius_px,
        grass=turf.colour,
    )
    _paint_grass(canvas, rng, station, turf)
    _paint_wall(canvas, station, wall(rng, light))
    white = tuple(float(c) for c in np.array([245, 248, 242]) * turf.line)
    for path in markings():
        _ribbon(canvas, station, path, LINE_M, white)
    _paint_goals(canvas, station)
    _paint_litter(canvas, rng, station)
    return replace(canvas, image=np.asarray(cv2.cvtColor(canvas.image, cv2.COLOR_RGB2RGBA)))


def _angles(canvas: Canvas, step: int) -> tuple[Points, Points]:
    """Return bearings of the columns and drops of the rows, every `step` pixels."""
    h, w = canvas.image.shape[:2]
    xs = canvas.origin[0] + (np.arange(0, w, step) + step / 2) / canvas.radius_px
    ys = canvas.origin[1] + (np.arange(0, h, step) + step / 2) / canvas.radius_px
    return np.asarray(xs, np.float64), np.asarray(ys, np.float64)


def _paint_grass(canvas: Canvas, rng: np.random.Generator, station: Station, turf: Turf) -> None:
    step = 2
    columns, rows = _angles(canvas, step)
    xs, ys = np.asarray(columns, np.float32), np.asarray(rows, np.float32)
    reach = np.float32(station.height_m) / np.maximum(ys, np.float32(0.02))[:, None]
    x = np.float32(station.x_m) + reach * np.sin(xs)[None]
    y = np.float32(station.y_m) - reach * np.cos(xs)[None]
    bands = np.zeros_like(x)
    if turf.pattern in ("across", "checks"):
        bands += np.sign(np.sin(np.float32(np.pi / turf.stripe_m) * x))
    if turf.pattern in ("along", "checks"):
        bands += np.sign(np.sin(np.float32(np.pi / turf.stripe_m) * y))
    worn = cv2.resize(rng.normal(0, 0.03, (40, 60)), x.shape[::-1])
    light = np.asarray(1 + turf.stripe * bands + worn, np.float32)
    inside = (x > -2) & (x < PITCH_M[0] + 2) & (y > -2) & (y < PITCH_M[1] + 2)
    light *= np.where(inside, 1, np.float32(rng.uniform(0.72, 1.05)))
    colour = np.array(turf.colour, np.float32)
    h, w = canvas.image.shape[:2]
    small = np.clip(light[..., None] * colour, 0, 255).astype(np.uint8)
    cv2.resize(small, (w, h), dst=canvas.image, interpolation=cv2.INTER_LINEAR)
    tile = blades(rng, turf.noise)
    for top in range(0, h, 512):
        for left in range(0, w, 512):
            part = canvas.image[top : top + 512, left : left + 512]
            grain = cv2.merge([tile[: part.shape[0], : part.shape[1]]] * 3)
            cv2.add(part, grain, dst=part, dtype=cv2.CV_8U)


def blades(rng: np.random.Generator, noise: float) -> NDArray[np.int8]:
    """Return fine and coarse noise of grass: (512, 512), to be added."""
    fine = rng.normal(0, 1, (512, 512))
    mixed = fine * 0.6 + cv2.GaussianBlur(fine, (0, 0), 0.9) * 2.2
    mixed = mixed + cv2.GaussianBlur(fine, (0, 0), 4) * 3
    return np.clip(mixed * noise, -60, 60).astype(np.int8)


def _paint_wall(canvas: Canvas, station: Station, picture: Image) -> None:
    """Draw the far wall and both side walls, from one flat picture around the pitch."""
    xs, ys = (a.astype(np.float32) for a in _angles(canvas, 1))
    far = (station.y_m + BEHIND_M) / np.maximum(np.cos(xs), 0.05)
    reach_x = np.where(xs < 0, -station.x_m - BEHIND_M, PITCH_M[0] + BEHIND_M - station.x_m)
    side = reach_x / np.where(np.abs(np.sin(xs)) < 1e-3, 1e-3, np.sin(xs))
    side = np.where(side > 0, side, np.inf)
    reach = np.minimum(far, side)
    x, y = station.x_m + reach * np.sin(xs), station.y_m - reach * np.cos(xs)
    along = WALL_M[0] / 2 + x - PITCH_M[0] / 2 + np.sign(xs) * (y + BEHIND_M)
    up = station.height_m - ys[:, None] * reach[None]
    rows = np.flatnonzero((up > 0).any(1))[-1] + 1
    map_y = (WALL_M[1] - up[:rows]) * WALL_PX_PER_M
    map_x = np.broadcast_to(along * WALL_PX_PER_M, map_y.shape)
    drawn = cv2.remap(
        picture,
        np.ascontiguousarray(map_x, np.float32),
        np.ascontiguousarray(map_y, np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REFLECT,
    )
    inside = up[:rows] > 0
    canvas.image[:rows][inside] = drawn[inside]


def markings() -> list[Points]:
    """Return the lines of a pitch as paths (n, 3) in metres, after law 1 of the game."""
    w, h = PITCH_M
    paths = [_path([(0, 0), (w, 0), (w, h), (0, h), (0, 0)]), _path([(w / 2, 0), (w / 2, h)])]
    paths += [_arc((w / 2, h / 2), 9.15, 0, 2 * np.pi), _arc((w / 2, h / 2), 0.1, 0, 2 * np.pi)]
    for end, sign in ((0.0, 1), (w, -1)):
        for deep, wide in ((16.5, 40.32), (5.5, 18.32)):
            a, b, x = (h - wide) / 2, (h + wide) / 2, end + sign * deep
            paths.append(_path([(end, a), (x, a), (x, b), (end, b)]))
        spot = (end + sign * 11.0, h / 2)
        half = np.arccos(5.5 / 9.15)
        middle = 0.0 if sign > 0 else np.pi
        paths += [_arc(spot, 9.15, middle - half, middle + half), _arc(spot, 0.06, 0, 2 * np.pi)]
        for corner, turn in ((0.0, 0.0), (h, 1.5 * np.pi)):
            start = turn if sign > 0 else (np.pi / 2 if corner == 0 else np.pi)
            paths.append(_arc((end, corner), 1.0, start, start + np.pi / 2))
    return paths


def _path(corners: list[tuple[float, float]]) -> Points:
    points = np.array(corners, float)
    pieces = [
        np.linspace(a, b, max(2, int(np.hypot(*(b - a)))), endpoint=False)
        for a, b in pairwise(points)
    ]
    flat = np.concatenate([*pieces, points[-1:]])
    return np.column_stack([flat, np.zeros(len(flat))])


def _arc(middle: tuple[float, float], radius: float, start: float, end: float) -> Points:
    turn = np.linspace(start, end, 48)
    flat = np.array(middle) + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.column_stack([flat, np.zeros(len(flat))])


def _ribbon(
    canvas: Canvas, station: Station, path: Points, wide_m: float, colour: tuple[float, ...]
) -> None:
    """Draw a line on the ground, with its width in perspective."""
    way = np.gradient(path[:, :2], axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True) + 1e-9
    aside = np.column_stack([-way[:, 1], way[:, 0], np.zeros(len(way))]) * wide_m / 2
    edges = [
        np.round(canvas.pixels(station.angles(path + s * aside)) * 2**SHIFT).astype(np.int32)
        for s in (-1, 1)
    ]
    for i in range(len(path) - 1):
        quad = np.array([edges[0][i], edges[0][i + 1], edges[1][i + 1], edges[1][i]])
        cv2.fillConvexPoly(canvas.image, quad, colour, cv2.LINE_AA, SHIFT)


def _rods(
    canvas: Canvas, station: Station, rods: list[Points], thick_px: int, colour: Colour
) -> None:
    for rod in rods:
        pixels = np.round(canvas.pixels(station.angles(rod)) * 2**SHIFT).astype(np.int32)
        cv2.polylines(canvas.image, [pixels], False, colour, thick_px, cv2.LINE_AA, SHIFT)


def _paint_goals(canvas: Canvas, station: Station) -> None:
    wide, high = GOAL_M
    a, b = (PITCH_M[1] - wide) / 2, (PITCH_M[1] + wide) / 2
    post = max(
        1, round(0.12 * canvas.radius_px / float(station.distance_m(np.array([52.5, 34.0]))))
    )
    for end, sign in ((0.0, -1), (PITCH_M[0], 1)):
        back = end + sign * 2.0
        threads = [
            np.array([(end, y, high), (end + sign * 0.8, y, high), (back, y, 0)])
            for y in np.linspace(a, b, 30)
        ]
        for up in np.linspace(0, high, 12):
            x = back - sign * 1.2 * up / high
            threads.append(np.array([(end, a, up), (x, a, up), (x, b, up), (end, b, up)]))
        _rods(canvas, station, threads, 1, (190, 195, 190))
        frame = np.array([(end, a, 0), (end, a, high), (end, b, high), (end, b, 0)])
        _rods(canvas, station, [frame], post, (245, 245, 245))


def _paint_litter(canvas: Canvas, rng: np.random.Generator, station: Station) -> None:
    """Draw corner flags, bottles and similar: small bright objects other than the ball."""
    for x in (0.0, PITCH_M[0]):
        for y in (0.0, PITCH_M[1]):
            scale = canvas.radius_px / float(station.distance_m(np.array([x, y])))
            pole = np.array([(x, y, 0), (x, y, 1.5)])
            _rods(canvas, station, [pole], max(1, round(0.05 * scale)), (235, 235, 235))
            foot = np.array([(x, y, 0), (x, y, 0.12)])
            _rods(canvas, station, [foot], max(1, round(0.12 * scale)), (240, 240, 240))
            top = np.array([(x, y, 1.5), (x + 0.45, y, 1.32), (x, y, 1.15)])
            flag = np.round(canvas.pixels(station.angles(top))).astype(np.int32)
            cv2.fillConvexPoly(canvas.image, flag, rng.integers(60, 250, 3).tolist(), cv2.LINE_AA)
    for _ in range(int(rng.integers(6, 18))):
        x, y = rng.uniform(-3, 108), float(rng.choice([-2.5, -1.8, 69.5]))
        if rng.random() < 0.4:
            x, y = float(rng.choice([-1.5, 106.5])), rng.uniform(28, 40)
        bottle = np.array([(x, y, 0), (x, y, 0.24)])
        scale = canvas.radius_px / float(station.distance_m(np.array([x, y])))
        colour = rng.choice([[240, 240, 240], [90, 160, 240], [240, 150, 40]]).tolist()
        _rods(canvas, station, [bottle], max(1, round(0.09 * scale)), colour)
