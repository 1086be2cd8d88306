"""Augment a training picture: Example -> Example.

Without pasted balls the network hardly learns balls; pasted look-alikes reduce false ones. Clutter
in the background prevents overfitting to the procedural stands.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.example import BALL, NAMES, Example
from operators.saliency.movement import ball_movement, person_movement, roughened, with_motion
from operators.saliency.sensor_noise import through_sensor
from operators.training.photometric import degrade, recolour

BALL_LABEL = NAMES.index(BALL)
LEAST_SHARE = 0.3  # share of an object that must remain in the picture
BALL_TO_PERSON = (0.085, 0.17)  # diameter over height; a ball measures 0.22 m
GROUND_SHARE = 0.6  # of the balls that lie still: anywhere on the grass, and not at somebody
FINE = 8  # sub-pixels a side of a pasted thing
MOST_BALL_PX = 14.0  # diameter in a context, enlarged or not


def augment(example: Example, rng: np.random.Generator, raw_share: float = 0.0) -> Example:
    """Zoom, shift and mirror; clutter; paste; recolour; soften, roughen and compress.

    `raw_share` of the pictures are then seen through a raw sensor.
    """
    example = move(example, rng)
    if rng.random() < 0.6:
        example = replace(example, picture=clutter(example, rng))
    example = paste(example, rng)
    picture = degrade(recolour(example.picture, rng), rng)
    if raw_share and rng.random() < raw_share:  # without it, as the shipped network was trained
        picture = through_sensor(picture, rng)
    return replace(example, picture=picture, difference=roughened(example.difference, rng))


def move(example: Example, rng: np.random.Generator) -> Example:
    """A random part of the picture at a random scale, mirrored every other time."""
    height, width = example.picture.shape[:2]
    zoom = float(np.exp(rng.uniform(np.log(0.75), np.log(1.8)))) if rng.random() < 0.75 else 1.0
    mirror = -1.0 if rng.random() < 0.5 else 1.0
    # the part that is left over, or missing, is shared out at random between both sides
    x = width / 2 * (1 - mirror * zoom) + (rng.random() - 0.5) * abs(zoom - 1) * width
    y = height / 2 * (1 - zoom) + (rng.random() - 0.5) * abs(zoom - 1) * height
    if zoom == 1.0 and mirror == 1.0:
        return example
    matrix = np.array([[mirror * zoom, 0, x], [0, zoom, y]], np.float64)
    # boxes are of edges; OpenCV maps pixels by their number, whose centres lie at halves
    pixels = matrix.copy()
    pixels[:, 2] += (matrix[[0, 1], [0, 1]] - 1) / 2
    fill = tuple(int(v) for v in rng.integers(0, 256, 3))
    picture = cv2.warpAffine(example.picture, pixels, (width, height), borderValue=fill)
    difference = example.difference
    if difference is not None:
        difference = np.asarray(cv2.warpAffine(difference, pixels, (width, height)), np.float32)
    boxes = example.boxes * np.float32(zoom)
    if mirror < 0:
        boxes = boxes[:, [2, 1, 0, 3]] * np.array([-1, 1, -1, 1], np.float32)
    boxes = boxes + np.array([x, y, x, y], np.float32)
    zoomed = replace(
        example, picture=np.asarray(picture, np.uint8), boxes=boxes, difference=difference
    )
    return cut(zoomed, width, height)


def cut(example: Example, width: int, height: int) -> Example:
    limits = np.array([width, height, width, height], np.float32)
    inside = np.clip(example.boxes, 0, limits)
    share = _area(inside) / np.maximum(_area(example.boxes), 1e-6)
    kept = share > 0.02
    return replace(
        example,
        boxes=inside[kept],
        labels=example.labels[kept],
        ignored=(example.ignored | (share < LEAST_SHARE))[kept],
    )


def _area(boxes: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]), np.float32)


def clutter(example: Example, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Add patches of noise, blobs, bars and letters outside people; mostly in the upper part."""
    picture = example.picture.copy()
    height, width = picture.shape[:2]
    taken = np.zeros((height, width), np.bool_)
    for left, top, right, bottom in np.round(example.boxes).astype(int).tolist():
        taken[max(top - 2, 0) : max(bottom + 2, 0), max(left - 2, 0) : max(right + 2, 0)] = True
    for _ in range(1 + rng.poisson(3.0)):
        wide, tall = (
            int(side) for side in np.exp(rng.uniform(np.log([24, 8]), np.log([320, 100])))
        )
        x = int(rng.integers(-wide // 2, width - wide // 2))
        y = int(min(rng.exponential(0.2), 0.95) * height) - tall // 4
        x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + wide, width), min(y + tall, height)
        if x1 - x0 < 4 or y1 - y0 < 4:
            continue
        patch = _texture(x1 - x0, y1 - y0, rng)
        free = ~taken[y0:y1, x0:x1]
        picture[y0:y1, x0:x1][free] = patch[free]
    return picture


def _texture(wide: int, tall: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return a texture like a distant stand, banner, fence or hoarding: (tall, wide, 3)."""
    ground = rng.uniform(10, 230, 3)
    patch = np.empty((tall, wide, 3), np.float32)
    patch[:] = ground
    for grain in (1, 2, 4, 8):  # noise of several sizes at once
        if rng.random() < 0.5:
            shape = (tall // grain + 2, wide // grain + 2, 3 if grain > 1 else 1)
            coarse = rng.standard_normal(shape, np.float32) * np.float32(rng.uniform(4, 40))
            if grain > 1:
                coarse = np.asarray(cv2.resize(coarse, None, fx=grain, fy=grain), np.float32)
            patch += coarse[:tall, :wide]
    drawn = np.clip(patch, 0, 255).astype(np.uint8)
    draw = rng.random()
    if draw < 0.35:
        for _ in range(int(wide * tall * rng.uniform(0.002, 0.025)) + 1):
            place = int(rng.integers(wide)), int(rng.integers(tall))
            sides = int(rng.integers(1, 4)), int(rng.integers(1, 5))
            ink = (rng.choice([20, 60, 130, 240]) + rng.normal(0, 25, 3)).tolist()
            cv2.ellipse(drawn, place, sides, 0, 0, 360, ink, -1)
    elif draw < 0.6:
        ink, step = rng.uniform(0, 255, 3).tolist(), int(rng.integers(3, 14))
        tilt, thick = int(rng.integers(-tall, tall + 1)), int(rng.integers(1, 3))
        for x in range(-tall, wide + tall, step):
            cv2.line(drawn, (x, 0), (x + tilt, tall), ink, thick)
    elif draw < 0.85:
        letters = "".join(chr(c) for c in rng.integers(48, 122, 40))
        ink, size = rng.uniform(0, 255, 3).tolist(), float(rng.uniform(0.2, max(0.25, tall / 24)))
        cv2.putText(drawn, letters, (-3, round(tall * 0.8)), 0, size, ink, 1, cv2.LINE_AA)
    return drawn


def paste(
    example: Example, rng: np.random.Generator, most_ball_px: float = MOST_BALL_PX
) -> Example:
    """Paste balls over people, lines, grass and stands, and white look-alikes."""
    people = example.boxes[example.labels != BALL_LABEL]
    tall = float(np.median(people[:, 3] - people[:, 1])) if len(people) else 36.0
    picture, difference = example.picture.copy(), example.difference
    for _ in range(rng.poisson(1.5)):
        under = picture.copy()
        _draw_lookalike(picture, somewhere(example, rng), tall, rng)
        # a boot moves, a scrap of paper does not
        shift = person_movement(tall, rng) * np.float32(rng.integers(2))
        difference = with_motion(difference, under, picture, shift)
    found = []
    for _ in range(rng.poisson(1.2)):
        under = picture.copy()
        diameter = float(np.clip(tall * rng.uniform(*BALL_TO_PERSON), 2.2, most_ball_px))
        smear, shift = ball_movement(diameter, rng)
        place = somewhere(example, rng) if shift.any() else at_rest(example, rng)
        found.append(draw_ball(picture, place, diameter, smear, rng))
        difference = with_motion(difference, under, picture, shift)
    balls = np.array(found, np.float32).reshape(-1, 4)
    pasted = replace(
        example,
        picture=picture,
        boxes=np.concatenate([example.boxes, balls]),
        labels=np.concatenate([example.labels, np.full(len(balls), BALL_LABEL)]),
        ignored=np.concatenate([example.ignored, np.zeros(len(balls), np.bool_)]),
        difference=difference,
    )
    return cut(pasted, picture.shape[1], picture.shape[0])


def somewhere(example: Example, rng: np.random.Generator) -> tuple[float, float]:
    """Return a position: near a person or anywhere, sometimes on a bright spot."""
    height, width = example.picture.shape[:2]
    draw = rng.random()
    if draw < 0.4 and len(example.boxes):
        left, top, right, bottom = example.boxes[rng.integers(len(example.boxes))]
        x = (left + right) / 2 + rng.normal() * (right - left) * 0.7
        low = rng.random() < 0.6
        y = bottom - rng.normal() * 4 if low else rng.uniform(top, bottom)
        return float(np.clip(x, 3, width - 4)), float(np.clip(y, 3, height - 4))
    places = rng.random((24, 2)) * (width - 8, height - 8) + 4
    if draw < 0.55:
        bright = example.picture[places[:, 1].astype(int), places[:, 0].astype(int)].sum(1)
        return float(places[bright.argmax(), 0]), float(places[bright.argmax(), 1])
    return float(places[0, 0]), float(places[0, 1])


def at_rest(example: Example, rng: np.random.Generator) -> tuple[float, float]:
    """Return a position for a ball that lies still: mostly on the grass, where people stand."""
    feet = example.boxes[example.labels != BALL_LABEL, 3]
    if not len(feet) or rng.random() > GROUND_SHARE:
        return somewhere(example, rng)
    height, width = example.picture.shape[:2]
    low = min(float(feet.max()) + 0.3 * float(np.ptp(feet)), height - 5)
    return float(rng.uniform(4, width - 4)), float(rng.uniform(min(float(feet.min()), low), low))


def draw_ball(
    picture: NDArray[np.uint8],
    place: tuple[float, float],
    diameter: float,
    smear_px: NDArray[np.float32],
    rng: np.random.Generator,
) -> tuple[float, float, float, float]:
    """A lit, patterned disc, smeared by its movement; returns its box, smear included."""
    dx, dy = (float(part) for part in smear_px)
    smear = float(np.hypot(dx, dy))
    reach = int(np.ceil((diameter + smear) / 2)) + 2
    left, top = int(place[0]) - reach, int(place[1]) - reach
    side = 2 * reach + 1
    y, x = (np.mgrid[: side * FINE, : side * FINE] + 0.5) / FINE
    x, y = x - (place[0] - left), y - (place[1] - top)
    shade = np.zeros((side * FINE, side * FINE), np.float32)
    cover = np.zeros_like(shade)
    light = rng.normal(size=2) * 0.12 + np.array([0, -0.15])
    spots = rng.uniform(-0.5, 0.5, (5, 2)) * diameter
    dark = rng.uniform(0, 0.7) if rng.random() < 0.5 else 0.0
    steps = 1 if smear == 0 else 5
    for step in np.linspace(-0.5, 0.5, steps) if steps > 1 else [0.0]:
        u, v = (x - step * dx) * 2 / diameter, (y - step * dy) * 2 / diameter
        disc = (u * u + v * v < 1).astype(np.float32)
        value = 1 + light[0] * u + light[1] * v - 0.25 * (u * u + v * v)
        for spot in spots if dark else ():
            near = (u * diameter / 2 - spot[0]) ** 2 + (v * diameter / 2 - spot[1]) ** 2
            value = value - dark * (near < (diameter * 0.13) ** 2)
        cover += disc / steps
        shade += disc * value.astype(np.float32) / steps
    colour = rng.uniform(170, 255) * (1 + rng.normal(size=3) * 0.04)
    if rng.random() < 0.1:
        colour = rng.uniform([180, 150, 20], [255, 240, 160])
    blend(picture, left, top, cover, shade, colour)
    half_w, half_h = (diameter + abs(dx)) / 2, (diameter + abs(dy)) / 2
    return place[0] - half_w, place[1] - half_h, place[0] + half_w, place[1] + half_h


def _draw_lookalike(
    picture: NDArray[np.uint8], place: tuple[float, float], tall: float, rng: np.random.Generator
) -> None:
    """A white bar, flat ellipse or corner: boots, socks, spots, line crossings, letters."""
    size = tall * rng.uniform(0.05, 0.2)
    reach = int(np.ceil(size * 1.6)) + 2
    left, top = int(place[0]) - reach, int(place[1]) - reach
    canvas = np.zeros(((2 * reach + 1) * FINE,) * 2, np.float32)
    centre = ((place[0] - left) * FINE, (place[1] - top) * FINE)
    sides = (size * FINE * rng.uniform(0.9, 1.8), size * FINE * rng.uniform(0.2, 0.45))
    kind = rng.integers(3)
    turns = [0.0] if kind == 0 else [rng.uniform(0, 180)]
    if kind == 2:
        turns.append(turns[0] + rng.uniform(50, 130))
    for turn in turns:
        if kind == 0:
            cv2.ellipse(canvas, (centre, sides, turn), 1.0, -1)
        else:
            corners = cv2.boxPoints((centre, sides, turn))
            cv2.fillPoly(canvas, [corners.astype(np.int32)], 1.0)
    colour = rng.uniform(150, 255) * (1 + rng.normal(size=3) * 0.05)
    blend(picture, left, top, canvas, canvas, colour)


def blend(
    picture: NDArray[np.uint8],
    left: int,
    top: int,
    cover: NDArray[np.float32],
    shade: NDArray[np.float32],
    colour: NDArray[np.float64],
) -> None:
    """Shrink a fine drawing by area and lay it over the picture, cut at its borders."""
    side = cover.shape[0] // FINE
    alpha = cv2.resize(cover, (side, side), interpolation=cv2.INTER_AREA)
    light = cv2.resize(shade, (side, side), interpolation=cv2.INTER_AREA)
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + side, picture.shape[1]), min(top + side, picture.shape[0])
    if x1 <= x0 or y1 <= y0:
        return
    part = np.s_[y0 - top : y1 - top, x0 - left : x1 - left]
    under = picture[y0:y1, x0:x1].astype(np.float32)
    over = under * (1 - alpha[part])[..., None] + light[part][..., None] * colour
    picture[y0:y1, x0:x1] = np.clip(over, 0, 255).astype(np.uint8)
