"""Add people cut out of other stills to a training picture: Example -> Example.

Referees are one person in nine: copies of them let the network see them before many backgrounds.
What is copied, a ball of `pasted_balls.py`, too, is cut out by its difference in colour from the
grass around it; what does not stand out clearly is not copied.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.augment import BALL_LABEL
from operators.saliency.example import NAMES, Example
from operators.saliency.movement import person_movement, with_motion

Array = NDArray[np.float32]
REFEREE_LABEL = NAMES.index("referee")
LEAST_DIFFERENCE = 26.0  # levels of the most different channel
PERSON_COVER = (0.18, 0.8)  # share of the box that stands out
MOST_GAIN = 1.3  # of a copy: a more enlarged one is blurred
MOST_HIDDEN = 0.5  # share of an object that a copy may cover
MOST_IN_CROWD = 0.75  # the same where people stand before one another, as at a free kick
HARDLY_SEEN = 0.85  # share of a person's box behind other boxes from which it need not be found


@dataclass(frozen=True, kw_only=True)
class Bank:
    """Where copies come from: how many stills there are, and each of them."""

    count: int
    still: Callable[[int], Example]


@dataclass(frozen=True, kw_only=True, eq=False)
class Cutout:
    """An object without its background."""

    picture: NDArray[np.uint8]  # (h, w, 3) RGB
    alpha: Array  # (h, w) 0..1


def paste_people(example: Example, bank: Bank, rng: np.random.Generator) -> Example:
    """Add up to four people beside those who are there, as tall as they are."""
    for _ in range(int(rng.integers(0, 5)) if rng.random() < 0.5 else 0):
        people = np.flatnonzero((example.labels != BALL_LABEL) & ~example.ignored)
        if not len(people):
            break
        near = example.boxes[rng.choice(people)]
        tall, feet = float(near[3] - near[1]), float(near[3])
        taken = chosen(bank, rng, _referees if rng.random() < 0.5 else _people)
        if taken is None:
            continue
        still, row = taken
        box = still.boxes[row]
        gain = tall * rng.uniform(0.85, 1.15) / max(float(box[3] - box[1]), 1.0)
        piece = cutout(still, row, gain, PERSON_COVER)
        if piece is None:
            continue
        high, wide = piece.alpha.shape
        x = (near[0] + near[2]) / 2 + rng.normal() * 4 * tall
        y = feet + rng.normal() * 0.5 * tall - high
        shift = person_movement(tall, rng)
        label = int(still.labels[row])
        example = laid_over(example, piece, int(x - wide / 2), int(y), label, rng, shift)
    return example


def paste_crowd(example: Example, bank: Bank, rng: np.random.Generator) -> Example:
    """Crowd up to five people around one who is there, before and behind one another.

    Half of the people of a broadcast view are covered to a quarter or more; few stills show a
    wall at a free kick, or the box at a corner.
    """
    people = np.flatnonzero((example.labels != BALL_LABEL) & ~example.ignored)
    if not len(people) or rng.random() > 0.35:
        return example
    known = len(example.labels)
    near = example.boxes[rng.choice(people)]
    tall, wide_px = float(near[3] - near[1]), float(near[2] - near[0])
    feet = np.sort(near[3] + rng.normal(0, 0.12, int(rng.integers(2, 6))) * tall)
    for low in feet.tolist():  # who stands nearer covers those behind
        taken = chosen(bank, rng, _people)
        if taken is None:
            continue
        still, row = taken
        own = max(float(still.boxes[row][3] - still.boxes[row][1]), 1.0)
        piece = cutout(still, row, tall * rng.uniform(0.92, 1.08) / own, PERSON_COVER)
        if piece is None:
            continue
        high, wide = piece.alpha.shape
        x = (near[0] + near[2]) / 2 + rng.uniform(-1.8, 1.8) * wide_px
        shift = person_movement(tall, rng)
        label = int(still.labels[row])
        example = laid_over(
            example, piece, int(x - wide / 2), int(low - high), label, rng, shift, MOST_IN_CROWD
        )
    return without_covered(example, known)


def without_covered(example: Example, known: int) -> Example:
    """The example in which who is hardly seen behind those from row `known` on does not count."""
    height, width = example.picture.shape[:2]
    edges = np.clip(np.round(example.boxes).astype(int), 0, [width, height, width, height])
    covered = np.zeros((height, width), np.bool_)
    ignored = example.ignored.copy()
    for row in reversed(range(len(edges))):  # the last one laid is before all others
        left, top, right, bottom = edges[row].tolist()
        part = covered[top:bottom, left:right]
        ignored[row] |= bool(part.size and part.mean() > HARDLY_SEEN)
        if row >= known:
            part[:] = True
    return replace(example, ignored=ignored)


def paste_at_boards(example: Example, bank: Bank, rng: np.random.Generator) -> Example:
    """Add up to two people, mostly referees, where the grass ends behind the farthest person.

    Assistants stand there, a few pixels high before boards; few stills show many of them.
    """
    people = np.flatnonzero((example.labels != BALL_LABEL) & ~example.ignored)
    if not len(people):
        return example
    boxes = example.boxes[people]
    far = boxes[boxes[:, 3].argmin()]
    grass = is_grass(cv2.cvtColor(example.picture, cv2.COLOR_RGB2HSV))
    for _ in range(int(rng.integers(1, 3)) if rng.random() < 0.5 else 0):
        taken = chosen(bank, rng, _referees if rng.random() < 0.7 else _people)
        if taken is None:
            continue
        still, row = taken
        tall = float(far[3] - far[1]) * rng.uniform(0.75, 1.1)
        box = still.boxes[row]
        piece = cutout(still, row, tall / max(float(box[3] - box[1]), 1.0), PERSON_COVER)
        x = int(rng.integers(example.picture.shape[1]))
        edge = end_of_grass(grass[:, x], tall)
        if piece is None or edge > far[3]:
            continue
        high, wide = piece.alpha.shape
        feet = edge + tall * rng.uniform(0.0, 0.4)
        label = int(still.labels[row])
        shift = person_movement(tall, rng)
        example = laid_over(example, piece, int(x - wide / 2), int(feet - high), label, rng, shift)
    return example


def is_grass(hsv: NDArray[Any]) -> NDArray[np.bool_]:
    """Which pixels (h, w, 3) of OpenCV's hue (2 degrees), saturation, value are grass: (h, w)."""
    return np.asarray((hsv[..., 0] > 28) & (hsv[..., 0] < 85) & (hsv[..., 1] > 40))


def end_of_grass(column: NDArray[np.bool_], tall_px: float) -> int:
    """The row at which the grass ends that begins at the lower border of a picture.

    Lines, feet and balls on it, lower than a third of a person, do not end it.
    """
    most = max(2, round(tall_px / 3))
    rows = np.flatnonzero(column)
    if not len(rows):
        return len(column)
    gaps = np.flatnonzero(np.diff(rows) > most)
    return int(rows[gaps[-1] + 1] if len(gaps) else rows[0])


def _people(labels: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(labels != BALL_LABEL)


def _referees(labels: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(labels == REFEREE_LABEL)


def chosen(
    bank: Bank, rng: np.random.Generator, fits: Callable[[NDArray[np.int64]], NDArray[np.bool_]]
) -> tuple[Example, int] | None:
    """A random still and an object in it; none where that still has nothing that fits."""
    still = bank.still(int(rng.integers(bank.count)))
    rows = np.flatnonzero(fits(still.labels))
    return (still, int(rng.choice(rows))) if len(rows) else None


def cutout(
    still: Example, row: int, gain: float, cover: tuple[float, float], most_gain: float = MOST_GAIN
) -> Cutout | None:
    """An object, scaled, without its background; none where it does not stand out."""
    left, top, right, bottom = np.round(still.boxes[row]).astype(int).tolist()
    high, wide = still.picture.shape[:2]
    margin = 2
    if left < margin or top < margin or right > wide - margin or bottom > high - margin:
        return None
    part = still.picture[top - margin : bottom + margin, left - margin : right + margin]
    size = round(part.shape[1] * gain), round(part.shape[0] * gain)
    if gain > most_gain or min(size) < 2 or min(part.shape[:2]) < 2 * margin + 3:
        return None
    frame = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
    away = np.abs(part.astype(np.float32) - np.median(frame, axis=0)).max(2)
    alpha = np.clip((away - LEAST_DIFFERENCE / 2) / LEAST_DIFFERENCE, 0, 1).astype(np.float32)
    alpha[:1], alpha[-1:], alpha[:, :1], alpha[:, -1:] = 0, 0, 0, 0
    alpha = np.asarray(cv2.GaussianBlur(alpha, (0, 0), 0.7), np.float32)
    inner = alpha[margin:-margin, margin:-margin]
    if not cover[0] <= float((inner > 0.5).mean()) <= cover[1]:
        return None
    how = cv2.INTER_AREA if gain < 1 else cv2.INTER_LINEAR
    return Cutout(
        picture=np.asarray(cv2.resize(part, size, interpolation=how), np.uint8),
        alpha=np.asarray(cv2.resize(alpha, size, interpolation=how), np.float32),
    )


def laid_over(
    example: Example, piece: Cutout, left: int, top: int, label: int, rng: np.random.Generator,
    shift_px: Array, most_hidden: float = MOST_HIDDEN,
) -> Example:  # fmt: skip
    """The example with a piece laid over it, unless that leaves the picture or hides an object.

    `shift_px` (x, y): how far it moved since the frame before.
    """
    height, width = example.picture.shape[:2]
    high, wide = piece.alpha.shape
    box = np.array([left, top, left + wide, top + high], np.float32)
    if left < 0 or top < 0 or left + wide > width or top + high > height:
        return example
    low, far = np.maximum(example.boxes[:, :2], box[:2]), np.minimum(example.boxes[:, 2:], box[2:])
    common = np.clip(far - low, 0, None).prod(1)
    own = (example.boxes[:, 2:] - example.boxes[:, :2]).prod(1)
    if label != BALL_LABEL and (common > most_hidden * np.maximum(own, 1)).any():
        return example
    picture = example.picture.copy()
    under = picture[top : top + high, left : left + wide].astype(np.float32)
    over = piece.picture[:, ::-1] if rng.random() < 0.5 else piece.picture
    alpha = piece.alpha[:, ::-1] if over is not piece.picture else piece.alpha
    mixed = under + alpha[..., None] * (over.astype(np.float32) * rng.uniform(0.85, 1.15) - under)
    picture[top : top + high, left : left + wide] = np.clip(mixed, 0, 255).astype(np.uint8)
    solid = np.argwhere(alpha > 0.3 * alpha.max())
    if not len(solid):
        return example
    (y0, x0), (y1, x1) = solid.min(0), solid.max(0) + 1
    tight = left + x0, top + y0, left + x1, top + y1
    difference = with_motion(example.difference, example.picture, picture, shift_px)
    return replace(with_object(example, picture, tight, label), difference=difference)


def with_object(
    example: Example, picture: NDArray[np.uint8], box: tuple[float, float, float, float], label: int
) -> Example:
    """The example with another picture, in which one more object is."""
    return replace(
        example,
        picture=picture,
        boxes=np.concatenate([example.boxes, np.array([box], np.float32)]),
        labels=np.append(example.labels, label),
        ignored=np.append(example.ignored, False),
    )
