"""Draw what never moves: mast, conditions and a seed -> grass, lines, goals and stands on a canvas.

Row and column of the canvas are linear in the camera's angles, as in `soccer.pitch`.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.camera import PITCH_M, Points
from drivers.scenes.soccer.pitch import (
    BEHIND_M,
    GOAL_M,
    LINE_M,
    SHIFT,
    Canvas,
    Turf,
    blades,
    markings,
)
from drivers.scenes.soccer.stadium import BOARD_M, WALL_M, WALL_PX_PER_M, wall
from drivers.scenes.whole_pitch.conditions import Conditions
from drivers.scenes.whole_pitch.mast import Mast

Image = NDArray[np.uint8]

STEP = 2  # canvas pixels between two for which the grass is computed
GRASS_M = 4.0  # of it around the pitch, then a track
SLOPE = 0.62  # of the stands: metres up per metre away
STAND_M, ROOF_M = 34.0, 40.0  # length of the slope to the roof, and over it to the sky
ROOF = (34, 36, 42)
DECK_M = 43.0  # by which the picture of the next deck is moved along


def paint(
    canvas: Canvas, rng: np.random.Generator, mast: Mast, turf: Turf, conditions: Conditions
) -> None:
    """Draw the static world as the camera sees it, in place."""
    _paint_grass(canvas, rng, mast, turf, conditions)
    _paint_stands(canvas, mast, wall(rng, conditions.stand_light), conditions.sky)
    white = tuple(float(c) for c in np.array([245, 248, 242]) * turf.line * conditions.tint)
    for path in markings():
        _ribbon(canvas, mast, path, LINE_M, white)
    _paint_goals(canvas, mast)
    _paint_litter(canvas, rng, mast)
    if conditions.haze:
        grey = conditions.haze * conditions.haze_level
        cv2.convertScaleAbs(canvas.image, canvas.image, 1 - conditions.haze, grey)


def _angles(canvas: Canvas, step: int) -> tuple[Points, Points]:
    """Return bearings of the columns and drops of the rows, every `step` pixels, float32."""
    h, w = canvas.image.shape[:2]
    xs, ys = (
        first + (np.arange(0, side, step) + step / 2) / canvas.radius_px
        for first, side in zip(canvas.origin, (w, h), strict=True)
    )
    return np.asarray(xs, np.float32), np.asarray(ys, np.float32)


def _paint_grass(
    canvas: Canvas, rng: np.random.Generator, mast: Mast, turf: Turf, conditions: Conditions
) -> None:
    bearings, drops = _angles(canvas, STEP)
    station = mast.view.station
    reach = np.float32(station.height_m) / np.maximum(drops, np.float32(0.02))[:, None]
    x = np.float32(station.x_m) + reach * np.sin(bearings)[None]
    y = np.float32(station.y_m) - reach * np.cos(bearings)[None]
    along, across = (np.float32(PITCH_M[0]) - y, x) if mast.turned else (x, y)
    worn = 1 + _spread(rng.normal(0, 0.03, (40, 90)), x.shape)
    light = worn.copy()
    if turf.pattern in ("across", "checks"):
        light += turf.stripe * np.sign(np.sin(np.float32(np.pi / turf.stripe_m) * along))
    if turf.pattern in ("along", "checks"):
        light += turf.stripe * np.sign(np.sin(np.float32(np.pi / turf.stripe_m) * across))
    sheen = _spread(rng.normal(0, 1, (14, 40)), x.shape)
    light += np.float32(conditions.gloss) * (sheen + np.float32(0.5))
    picture = np.clip(light[..., None] * np.array(turf.colour, np.float32), 0, 255)
    beside = np.maximum(np.abs(along - 52.5) - 52.5, np.abs(across - 34) - 34) > GRASS_M
    track = np.array([128, 104, 98]) * conditions.tint * rng.uniform(0.8, 1.0)
    picture[beside] = worn[beside][:, None] * track.astype(np.float32)
    h, w = canvas.image.shape[:2]
    cv2.resize(picture.astype(np.uint8), (w, h), dst=canvas.image)
    tile = blades(rng, turf.noise / 2)
    for top in range(0, h, len(tile)):
        for left in range(0, w, len(tile)):
            part = canvas.image[top : top + len(tile), left : left + len(tile)]
            grain = cv2.merge([tile[: part.shape[0], : part.shape[1]]] * 3)
            cv2.add(part, grain, dst=part, dtype=cv2.CV_8U)


def _spread(values: Points, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return a small table of values, smoothly enlarged to (h, w)."""
    return np.asarray(
        cv2.resize(values.astype(np.float32), shape[::-1], interpolation=cv2.INTER_CUBIC)
    )


def _paint_stands(canvas: Canvas, mast: Mast, picture: Image, sky: Points) -> None:
    """Draw boards and sloping stands on the three far sides, from one flat picture around them.

    `sky` is the colour (3,) of what is above the roofs.
    """
    bearings, drops = _angles(canvas, 1)
    station, (wide, _) = mast.view.station, mast.field_m
    far = (station.y_m + BEHIND_M) / np.maximum(np.cos(bearings), 0.05)
    aside = np.where(bearings < 0, -station.x_m - BEHIND_M, wide + BEHIND_M - station.x_m)
    turn = np.sin(bearings)
    side = aside / np.where(np.abs(turn) < 1e-3, 1e-3, turn)
    reach = np.minimum(far, np.where(side > 0, side, np.inf))
    x, y = station.x_m + reach * np.sin(bearings), station.y_m - reach * np.cos(bearings)
    along = WALL_M[0] / 2 + x - wide / 2 + np.sign(bearings) * (y + BEHIND_M)
    rows = int(np.searchsorted(drops, station.height_m / reach.min()))
    drops = drops[:rows, None]
    up = station.height_m - drops * reach[None]  # on the upright boards, metres
    slope = np.maximum(up - BOARD_M, 0) / (1 + drops / np.float32(SLOPE))  # height above them
    up = np.where(up > BOARD_M, BOARD_M + slope * float(np.hypot(1, 1 / SLOPE)), up)
    rise = WALL_M[1] - BOARD_M
    deck = np.maximum(up - BOARD_M, 0) // rise
    map_x = (along + deck * DECK_M) % WALL_M[0] * WALL_PX_PER_M
    map_y = (WALL_M[1] - up + deck * rise) * WALL_PX_PER_M
    drawn = cv2.remap(
        picture,
        np.ascontiguousarray(map_x, np.float32),
        np.ascontiguousarray(map_y, np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REFLECT,
    )
    drawn[up > STAND_M] = ROOF
    drawn[up > ROOF_M] = sky
    inside = up > 0
    canvas.image[:rows][inside] = drawn[inside]


def _pixels(canvas: Canvas, mast: Mast, path: Points) -> NDArray[np.int32]:
    """Return a path (n, 3) on the pitch as OpenCV draws it: (n, 2), `SHIFT` binary digits."""
    found = canvas.pixels(mast.view.station.angles(mast.seen(path))) - 0.5
    return np.asarray(np.round(found * 2**SHIFT), np.int32)


def _ribbon(
    canvas: Canvas, mast: Mast, path: Points, wide_m: float, colour: tuple[float, ...]
) -> None:
    """Draw a line on the ground, with its width in perspective."""
    way = np.gradient(path[:, :2], axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True) + 1e-9
    aside = np.column_stack([-way[:, 1], way[:, 0], np.zeros(len(way))]) * wide_m / 2
    one, two = (_pixels(canvas, mast, path + sign * aside) for sign in (-1, 1))
    for i in range(len(path) - 1):
        quad = np.array([one[i], one[i + 1], two[i + 1], two[i]])
        cv2.fillConvexPoly(canvas.image, quad, colour, cv2.LINE_AA, SHIFT)


def _rod(
    canvas: Canvas, mast: Mast, path: Points, wide_m: float, colour: tuple[float, ...]
) -> None:
    """Draw a rod through points (n, 3), at least a pixel wide."""
    scale = canvas.radius_px / float(mast.view.station.distance_m(mast.seen(path)).mean())
    thick = max(1, round(wide_m * scale))
    pixels = [_pixels(canvas, mast, path)]
    cv2.polylines(canvas.image, pixels, False, colour, thick, cv2.LINE_AA, SHIFT)


def _paint_goals(canvas: Canvas, mast: Mast) -> None:
    wide, high = GOAL_M
    a, b = (PITCH_M[1] - wide) / 2, (PITCH_M[1] + wide) / 2
    for end, sign in ((0.0, -1), (PITCH_M[0], 1)):
        back = end + sign * 2.0
        for y in np.linspace(a, b, 30):
            thread = [(end, y, high), (end + sign * 0.8, y, high), (back, y, 0)]
            _rod(canvas, mast, np.array(thread), 0.01, (190, 195, 190))
        for up in np.linspace(0, high, 12):
            x = back - sign * 1.2 * up / high
            thread = [(end, a, up), (x, a, up), (x, b, up), (end, b, up)]
            _rod(canvas, mast, np.array(thread), 0.01, (190, 195, 190))
        frame = np.array([(end, a, 0), (end, a, high), (end, b, high), (end, b, 0)])
        _rod(canvas, mast, frame, 0.12, (245, 245, 245))


def _paint_litter(canvas: Canvas, rng: np.random.Generator, mast: Mast) -> None:
    """Draw corner flags, spare balls and bottles: small bright objects other than the ball."""
    for x in (0.0, PITCH_M[0]):
        for y in (0.0, PITCH_M[1]):
            _rod(canvas, mast, np.array([(x, y, 0), (x, y, 1.5)]), 0.05, (235, 235, 235))
            _rod(canvas, mast, np.array([(x, y, 0), (x, y, 0.12)]), 0.12, (240, 240, 240))
            top = np.array([(x, y, 1.5), (x + 0.45, y, 1.32), (x, y, 1.15)])
            colour = rng.integers(60, 250, 3).tolist()
            cv2.fillConvexPoly(canvas.image, _pixels(canvas, mast, top), colour, cv2.LINE_AA, SHIFT)
    for _ in range(int(rng.integers(10, 26))):
        x, y = rng.uniform(-3, 108), float(rng.choice([-3.2, -2.6, 70.6, 71.4]))
        if rng.random() < 0.4:
            x, y = float(rng.choice([-3.0, 108.0])), rng.uniform(0, 68)
        high = float(rng.choice([0.24, 0.1]))  # bottles, and balls that lie beside the pitch
        colours = ((240, 240, 240), (245, 245, 245), (90, 160, 240), (240, 150, 40))
        colour = colours[int(rng.integers(4))]
        wide = 0.09 if high > 0.2 else 0.2
        _rod(canvas, mast, np.array([(x, y, 0), (x, y, high)]), wide, colour)
