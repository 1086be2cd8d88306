"""Give a training picture the frame before it: Example -> Example with a frame difference.

A still has none. What is pasted into a picture is given one by where it was before: its brightness
is new where it is now, and missing where it was. People of a still move in the same way, as much of
them as stands out from the grass.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.difference import brightness
from operators.saliency.example import BALL, NAMES, Example

Array = NDArray[np.float32]
BALL_LABEL = NAMES.index(BALL)
KNOWN_SHARE = 0.85  # of the pictures; the others have no frame before them
PERSON_STEP = 0.07  # of a person's height between two frames: 3 m/s at 25 frames a second
SMEARED_SHARE = 0.5  # of the balls; others are sharp
SMEAR = 0.8  # mean, diameters: a kick moves a ball by one or two within half a frame
OPEN = (0.25, 1.0)  # share of the time between two frames in which light is gathered
LIES_STILL = 0.7  # share of the sharp balls; the others move and are exposed briefly
CAMERA_PX = 0.15  # by which the camera's movement is misjudged
FLAGS = 2.5  # mean number of captions, flags and changing boards in a picture


def ball_movement(diameter_px: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """How far a ball moves while its light is gathered, and between two frames: x, y in pixels."""
    angle = rng.uniform(0, 2 * np.pi)
    way = np.array([np.cos(angle), np.sin(angle)], np.float32)
    if rng.random() < SMEARED_SHARE:
        smear = way * np.float32(diameter_px * rng.exponential(SMEAR))
        return smear, smear / np.float32(rng.uniform(*OPEN))
    still = rng.random() < LIES_STILL
    step = 0.0 if still else diameter_px * rng.exponential(1.0)
    return np.zeros(2, np.float32), way * np.float32(step)


def person_movement(tall_px: float, rng: np.random.Generator) -> Array:
    """How far a person moves between two frames: x, y in pixels."""
    step = rng.normal(size=2) * tall_px * PERSON_STEP * (1.0, 0.4)
    return np.asarray(step, np.float32)


def with_motion(
    difference: Array | None, before: NDArray[np.uint8], after: NDArray[np.uint8], shift_px: Array
) -> Array | None:
    """The difference of a picture into which something was laid that moved by `shift_px`.

    `before` and `after` are the picture without and with it.
    """
    if difference is None or not np.any(shift_px):
        return difference  # what lies still is the same in both frames
    x, y, wide, high = cv2.boundingRect(
        brightness(np.asarray(cv2.absdiff(before, after), np.uint8))
    )
    gain = _brightness(after) - _brightness(before)
    changed = difference.copy()
    _left_behind(changed, gain, (x, y, wide, high), shift_px)
    return changed


def in_motion(example: Example, rng: np.random.Generator) -> Example:
    """A still with a frame before it: its people and balls move, and so did the camera."""
    if rng.random() > KNOWN_SHARE:
        return example
    light = _brightness(example.picture)
    difference = np.zeros_like(light)
    if rng.random() < 0.7:
        error = np.asarray(rng.normal(0, CAMERA_PX, 2), np.float32)
        difference += light - _shifted(light, error)
    for box, label in zip(example.boxes, example.labels, strict=True):
        _object_in_motion(difference, light, box, int(label), rng)
    _parts_in_motion(difference, light, rng)
    return replace(example, difference=difference)


def roughened(difference: Array | None, rng: np.random.Generator) -> Array | None:
    """The noise of two pictures, and the blur of a codec; each only sometimes."""
    if difference is None:
        return None
    if rng.random() < 0.3:
        difference = np.asarray(
            cv2.GaussianBlur(difference, (0, 0), rng.uniform(0.3, 1.0)), np.float32
        )
    if rng.random() < 0.6:
        spread = np.float32(rng.uniform(0.5, 6))
        difference = difference + spread * rng.standard_normal(difference.shape, np.float32)
    return difference


def _object_in_motion(
    difference: Array, light: Array, box: Array, label: int, rng: np.random.Generator
) -> None:
    height, width = light.shape
    left, top = np.maximum(np.floor(box[:2]).astype(int) - 1, 0)
    right, bottom = np.minimum(np.ceil(box[2:]).astype(int) + 1, (width, height))
    if right - left < 3 or bottom - top < 3:
        return
    part = light[top:bottom, left:right]
    ring = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
    own = np.zeros_like(light)
    own[top:bottom, left:right] = part - np.median(ring)
    if label == BALL_LABEL:
        # what is labelled as a ball is sharp: it lies, rolls, or was exposed briefly
        if rng.random() < LIES_STILL:
            return
        angle = rng.uniform(0, 2 * np.pi)
        step = float((box[2:] - box[:2]).max()) * rng.exponential(1.0)
        shift = np.array([np.cos(angle), np.sin(angle)], np.float32) * np.float32(step)
        _left_behind(difference, own, (left, top, right - left, bottom - top), shift)
        return
    tall = float(box[3] - box[1])
    shift = person_movement(tall, rng)
    waist = top + round((bottom - top) * rng.uniform(0.45, 0.7))
    legs = shift + person_movement(tall, rng)  # they swing beside the body's own movement
    _left_behind(difference, own, (left, top, right - left, waist - top), shift)
    _left_behind(difference, own, (left, waist, right - left, bottom - waist), legs)


def _left_behind(
    difference: Array, gain: Array, part: tuple[int, int, int, int], shift_px: Array
) -> None:
    """Add a gain of brightness where a thing is, in `part` (x, y, w, h); take it where it was.

    `difference` (h, w) is changed in place.
    """
    height, width = difference.shape
    x, y, wide, high = part
    reach = int(np.ceil(np.abs(shift_px).max())) + 1
    x0, y0 = max(x - reach, 0), max(y - reach, 0)
    x1, y1 = min(x + wide + reach, width), min(y + high + reach, height)
    if wide < 1 or high < 1 or x1 - x0 < 1 or y1 - y0 < 1:
        return
    own = np.zeros((y1 - y0, x1 - x0), np.float32)
    own[y - y0 : y - y0 + high, x - x0 : x - x0 + wide] = gain[y : y + high, x : x + wide]
    difference[y0:y1, x0:x1] += own - _shifted(own, shift_px, cv2.BORDER_CONSTANT)


def _shifted(values: Array, shift_px: Array, border: int = cv2.BORDER_REPLICATE) -> Array:
    """Values where they were before they moved by `shift_px`."""
    matrix = np.array([[1, 0, -shift_px[0]], [0, 1, -shift_px[1]]], np.float64)
    size = values.shape[1], values.shape[0]
    return np.asarray(cv2.warpAffine(values, matrix, size, borderMode=border), np.float32)


def _parts_in_motion(difference: Array, light: Array, rng: np.random.Generator) -> None:
    """Captions, which a panning camera does not move, and flags and boards, which do."""
    height, width = light.shape
    for _ in range(int(rng.poisson(FLAGS))):
        wide = 1 + int(width * rng.uniform(0.02, 0.25))
        high = 1 + int(height * rng.uniform(0.03, 0.15))
        x, y = int(rng.integers(0, max(1, width - wide))), int(height * rng.uniform(0, 0.35))
        if rng.random() < 0.15:
            y = max(0, height - high - int(height * rng.uniform(0.02, 0.1)))
        part = light[y : y + high, x : x + wide]
        shift = np.asarray(rng.normal(0, 2.5, 2), np.float32)
        before = _waved(part, rng) if rng.random() < 0.5 else _shifted(part, shift)
        difference[y : y + high, x : x + wide] = part - before


def _waved(part: Array, rng: np.random.Generator) -> Array:
    """A flag a moment before: shifted by another way at each place."""
    high, wide = part.shape
    y, x = np.mgrid[:high, :wide].astype(np.float32)
    length, angle, phase = rng.uniform(6, 40), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
    along = 2 * np.pi / length * (x * np.cos(angle) + y * np.sin(angle)) + phase
    wave = np.sin(along).astype(np.float32)
    step = rng.normal(0, 2.5, 2).astype(np.float32)
    moved_x, moved_y = x + step[0] * wave, y + step[1] * wave
    return np.asarray(
        cv2.remap(part, moved_x, moved_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        np.float32,
    )


def frame_before(example: Example) -> NDArray[np.uint8] | None:
    """The frame before as grey levels (h, w), the camera held still; none where there is none."""
    if example.difference is None:
        return None
    grey = _brightness(example.picture) - example.difference
    return np.asarray(np.clip(np.rint(grey), 0, 255), np.uint8)


def _brightness(picture: NDArray[np.uint8]) -> Array:
    return brightness(picture).astype(np.float32)
