"""Add balls to a training picture, cut out of other stills or drawn: Example -> Example.

A ball is in each still once: copies of it let the network see it before many backgrounds, smeared
by its movement, and in hands.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.augment import (
    BALL_LABEL,
    BALL_TO_PERSON,
    at_rest,
    draw_ball,
    somewhere,
)
from operators.saliency.example import Example
from operators.saliency.hands import hands_over
from operators.saliency.movement import ball_movement, person_movement
from operators.saliency.pasting import (
    MOST_GAIN,
    Bank,
    Cutout,
    chosen,
    cutout,
    laid_over,
    with_object,
)

Array = NDArray[np.float32]
BALL_COVER = (0.35, 0.9)  # share of the box that stands out
MOST_GAIN_NEAR = 2.6  # of a copy that is seen from near, where few balls are as large
HELD_SHARE = 0.15  # of the balls pasted: at somebody's hands, partly behind them
# of those seen from near: drawn ones in hands, since copies of far ones are blurred; of the copies
# those that are held, and of these those in drawn hands
DRAWN_SHARE, HELD_NEAR, GLOVED_SHARE = 0.18, 0.27, 0.55
EMPTY_SHARE = 0.25  # of the pictures seen from near: hands with nothing in them


def paste_balls(
    example: Example, bank: Bank, rng: np.random.Generator, *, near: bool = False
) -> Example:
    """Add up to two real balls of the size that people's height tells.

    Of what is seen from `near` one is always tried, many are in hands, some of these are drawn, and
    some hands are empty.
    """
    people = example.boxes[example.labels != BALL_LABEL]
    if not len(people):
        return example
    tall = float(np.median(people[:, 3] - people[:, 1]))
    if near and rng.random() < EMPTY_SHARE:
        empty = at_hands(people[rng.integers(len(people))], rng)
        size = tall * rng.uniform(*BALL_TO_PERSON)
        example = replace(example, picture=hands_over(example.picture, empty, size, rng))
    for _ in range(int(rng.integers(1, 3)) if near or rng.random() < 0.5 else 0):
        if near and rng.random() < DRAWN_SHARE:
            example = _drawn_in_hands(example, people[rng.integers(len(people))], rng)
            continue
        taken = chosen(bank, rng, _balls)
        if taken is None:
            continue
        still, row = taken
        box = still.boxes[row]
        diameter = max(tall * rng.uniform(*BALL_TO_PERSON), 1.8)
        gain = diameter / max(float((box[2:] - box[:2]).max()), 1.0)
        piece = cutout(still, row, gain, BALL_COVER, MOST_GAIN_NEAR if near else MOST_GAIN)
        if piece is None:
            continue
        smear, shift = ball_movement(diameter, rng)
        x, y = somewhere(example, rng) if shift.any() else at_rest(example, rng)
        held = rng.random() < (HELD_NEAR if near else HELD_SHARE)
        gloved = near and held and rng.random() < GLOVED_SHARE
        if held:
            x, y = at_hands(people[rng.integers(len(people))], rng)
            piece = piece if gloved else half_covered(piece, rng)
            shift = person_movement(tall, rng)
        elif smear.any():
            piece = smeared(piece, smear)
        high, wide = piece.alpha.shape
        left, top = int(x - wide / 2), int(y - high / 2)
        laid = laid_over(example, piece, left, top, BALL_LABEL, rng, shift)
        if gloved and laid is not example:
            laid = replace(laid, picture=hands_over(laid.picture, (x, y), diameter, rng))
        example = laid
    return example


def _drawn_in_hands(example: Example, person: Array, rng: np.random.Generator) -> Example:
    """The example with a drawn ball in somebody's hands, as sharp as the picture."""
    x, y = at_hands(person, rng)
    height, width = example.picture.shape[:2]
    if not (0 < x < width and 0 < y < height):
        return example
    diameter = float(person[3] - person[1]) * rng.uniform(*BALL_TO_PERSON)
    picture = example.picture.copy()
    box = draw_ball(picture, (x, y), diameter, np.zeros(2, np.float32), rng)
    picture = hands_over(picture, (x, y), diameter, rng)
    return with_object(example, picture, box, BALL_LABEL)


def at_hands(person: Array, rng: np.random.Generator) -> tuple[float, float]:
    """Where somebody (xyxy) holds a ball: before the body or beside it, between head and knees."""
    left, top, right, bottom = (float(side) for side in person)
    x = rng.uniform(left - 0.15 * (right - left), right + 0.15 * (right - left))
    return x, top + (bottom - top) * rng.uniform(0.2, 0.7)


def half_covered(piece: Cutout, rng: np.random.Generator) -> Cutout:
    """The object with up to a half of it behind something that bounds it by a straight line."""
    high, wide = piece.alpha.shape
    y, x = np.mgrid[:high, :wide].astype(np.float32)
    angle, reach = rng.uniform(0, 2 * np.pi), max(high, wide) / 2
    side = (x - (wide - 1) / 2) * np.cos(angle) + (y - (high - 1) / 2) * np.sin(angle)
    seen = np.clip(side + reach * rng.uniform(0.0, 0.7) + 0.5, 0, 1).astype(np.float32)
    return Cutout(picture=piece.picture, alpha=piece.alpha * seen)


def smeared(piece: Cutout, smear_px: Array) -> Cutout:
    """The object as an exposure sees it that moves by `smear_px` (x, y) meanwhile."""
    around = round(float(np.hypot(*smear_px)) / 2) + 1
    side = 2 * around + 1
    kernel = np.zeros((side, side), np.float32)
    for part in np.linspace(-0.5, 0.5, 4 * side):
        x, y = around + smear_px * part
        kernel[round(float(y)), round(float(x))] += 1 / (4 * side)
    alpha = np.pad(piece.alpha, around)
    light = piece.picture.astype(np.float32) * piece.alpha[..., None]
    light = np.pad(light, ((around, around), (around, around), (0, 0)))
    covered = np.asarray(cv2.filter2D(alpha, -1, kernel), np.float32)
    mixed = cv2.filter2D(light, -1, kernel) / np.maximum(covered, 1e-3)[..., None]
    return Cutout(picture=np.clip(mixed, 0, 255).astype(np.uint8), alpha=covered)


def _balls(labels: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(labels == BALL_LABEL)
