"""Draw corners of a pitch: an example -> one with a pole, lines and perhaps a ball at its foot.

At a corner kick the ball lies still on the line, at the foot of a pole. In a context both are one
bright pixel, and stills that show it are few. At least every second pole has no ball, so that a
pole alone is not taken for one.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.augment import BALL_LABEL, BALL_TO_PERSON, draw_ball
from operators.saliency.example import Example
from operators.saliency.pasting import end_of_grass, is_grass, with_object

CORNER_SHARE = 0.5  # of the pictures with people
FAR_SHARE = 0.5  # of the corners: at the far end of the grass
BALL_SHARE = 0.5  # of the corners, less those whose ball would leave the picture
LINE_SHARE = 0.25  # of the balls: on a line, away from the pole
BEFORE_SHARE = 0.6  # of the balls: before the pole, others behind it
LEAST_BALL_PX = 1.8
# sizes over a person's height: a pole of 1.5 m, 3 to 7 cm thick; a line of 12 cm, seen flat
POLE, THICK, LINE, FLAG = (0.8, 1.1), (0.018, 0.045), (0.02, 0.05), (0.15, 0.3)
REACH = (2.0, 12.0)  # of a line
STEEPEST = np.pi / 6  # of a line in the picture
FINE = 4  # sub-pixels a side
WHITE, YELLOW = (235.0, 235.0, 235.0), (230.0, 215.0, 60.0)
Array = NDArray[np.float32]
Picture = NDArray[np.uint8]  # (h, w, 3) RGB


def with_corner(example: Example, rng: np.random.Generator, most_ball_px: float) -> Example:
    """Return the example, a picture of a context's size or larger, with a corner, or as it is.

    A ball there lies at the pole's foot, before or behind it, or on one of the lines, and is at
    most `most_ball_px` wide. Lines and pole also cover people whose boxes they cross.
    """
    people = example.boxes[(example.labels != BALL_LABEL) & ~example.ignored]
    if not len(people) or rng.random() > CORNER_SHARE:
        return example
    tall = float(np.median(people[:, 3] - people[:, 1])) * rng.uniform(0.75, 1.15)
    height, width = example.picture.shape[:2]
    foot = _foot(example.picture, people, tall, rng)
    picture = example.picture.copy()
    chalk, cover = rng.uniform(170, 255), rng.uniform(0.45, 1.0)
    slopes = _slopes(rng)
    for slope in slopes:
        end = _along(foot, slope, tall * rng.uniform(*REACH))
        _line(picture, foot, end, tall * rng.uniform(*LINE), chalk, cover)
    ball = _ball(foot, slopes, tall, rng) if rng.random() < BALL_SHARE else None
    if ball is None or not _inside(ball[0], width, height):
        _pole(picture, foot, tall, rng)
        return replace(example, picture=picture)
    middle, diameter = ball[0], min(ball[1], most_ball_px)
    before = rng.random() < BEFORE_SHARE
    if before:
        _pole(picture, foot, tall, rng)
    box = draw_ball(picture, middle, diameter, np.zeros(2, np.float32), rng)
    if not before:
        _pole(picture, foot, tall, rng)
    return with_object(example, picture, box, BALL_LABEL)


def _ball(
    foot: tuple[float, float], slopes: tuple[float, float], tall: float, rng: np.random.Generator
) -> tuple[tuple[float, float], float]:
    """Centre and diameter of a ball at a pole's foot, or on one of the lines away from it."""
    diameter = max(tall * rng.uniform(*BALL_TO_PERSON), LEAST_BALL_PX)
    if rng.random() < LINE_SHARE:
        return _along(
            foot, slopes[int(rng.integers(2))], tall * rng.uniform(0.2, REACH[0])
        ), diameter
    x, y = rng.normal(0, 0.6) * diameter, rng.normal(0, 0.25) * diameter
    return (foot[0] + x, foot[1] - diameter / 2 + y), diameter


def _inside(place: tuple[float, float], width: int, height: int) -> bool:
    return 2 < place[0] < width - 2 and 2 < place[1] < height - 2


def _foot(
    picture: Picture, people: Array, tall: float, rng: np.random.Generator
) -> tuple[float, float]:
    """Where a pole stands: where people do, or as often where the grass ends, before boards."""
    height, width = picture.shape[:2]
    x = int(rng.integers(3, width - 3))
    low, high = float(people[:, 3].min()) - 0.3 * tall, float(people[:, 3].max())
    y = rng.uniform(low, high)
    if rng.random() < FAR_SHARE:
        grass = is_grass(cv2.cvtColor(picture[:, x : x + 1], cv2.COLOR_RGB2HSV))
        edge = end_of_grass(grass[:, 0], tall)
        if edge < high:  # otherwise this column shows no grass behind anybody
            y = edge + tall * rng.uniform(0.05, 0.5)
    return float(x), float(np.clip(y, 4, height - 4))


def _slopes(rng: np.random.Generator) -> tuple[float, float]:
    """Directions of two lines, radians: one right and one left, mostly both up or both down."""
    first, second = rng.uniform(0.02, STEEPEST, 2).tolist()
    side = -1.0 if rng.random() < 0.5 else 1.0
    return (side * first, np.pi - side * second * rng.uniform(-0.3, 1.0))


def _along(foot: tuple[float, float], slope: float, far_px: float) -> tuple[float, float]:
    return foot[0] + far_px * float(np.cos(slope)), foot[1] + far_px * float(np.sin(slope))


def _pole(
    picture: Picture, foot: tuple[float, float], tall: float, rng: np.random.Generator
) -> None:
    """A pole, white or yellow, with a flag that hangs or waves."""
    lean, high = rng.normal(0, 0.02), tall * rng.uniform(*POLE)
    top = foot[0] + lean * high, foot[1] - high
    light = rng.uniform(0.65, 1.05)
    colour = np.array(WHITE if rng.random() < 0.7 else YELLOW) * light
    _line(picture, foot, top, tall * rng.uniform(*THICK), colour, 1.0)
    side = tall * rng.uniform(*FLAG)
    wave = (1.0 if rng.random() < 0.5 else -1.0) * side * rng.uniform(0.25, 1.2)
    corners = np.array(
        [
            top,
            (top[0] + wave, top[1] + side * rng.uniform(0.0, 0.6)),
            (top[0] + wave * rng.uniform(0.6, 1.0), top[1] + side),
            (top[0], top[1] + side * 0.8),
        ],
        np.float32,
    )
    flag = rng.uniform(0, 255, 3) if rng.random() < 0.6 else colour
    _filled(picture, corners, flag, 1.0)


def _line(
    picture: Picture, start: tuple[float, float], end: tuple[float, float], thick_px: float,
    colour: float | NDArray[np.float64], cover: float,
) -> None:  # fmt: skip
    """A straight band."""
    a, b = np.array(start, np.float32), np.array(end, np.float32)
    across = np.array([a[1] - b[1], b[0] - a[0]], np.float32)
    across *= thick_px / 2 / max(float(np.hypot(*across)), 1e-6)
    _filled(picture, np.array([a - across, a + across, b + across, b - across]), colour, cover)


def _filled(
    picture: Picture, corners: Array, colour: float | NDArray[np.float64], cover: float
) -> None:
    """A polygon (n, 2) laid over the picture, averaged in its pixels; a quarter of one wider."""
    height, width = picture.shape[:2]
    low = np.clip(np.floor(corners.min(0)).astype(int) - 1, 0, (width, height))
    far = np.clip(np.ceil(corners.max(0)).astype(int) + 1, 0, (width, height))
    wide, high = (far - low).tolist()
    if wide < 1 or high < 1:
        return
    fine = np.zeros((high * FINE, wide * FINE), np.uint8)
    # 16ths of a sub-pixel; OpenCV counts from the middle of the first one
    points = ((corners - low) * FINE - 0.5) * 16
    cv2.fillConvexPoly(fine, np.rint(points).astype(np.int32), 255, cv2.LINE_8, 4)
    alpha = cv2.resize(fine, (wide, high), interpolation=cv2.INTER_AREA).astype(np.float32)
    alpha = alpha[..., None] * np.float32(cover / 255)
    part = picture[low[1] : far[1], low[0] : far[0]]
    part[:] = np.clip(part + alpha * (np.float32(colour) - part), 0, 255).astype(np.uint8)
