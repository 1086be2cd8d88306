"""Draw what is taken for a ball from near and is none: an example -> its picture with marks.

Shirts have numbers and badges, the grass has scraps of paper. Badges and scraps are smaller than a
ball beside people of that height; a number may be as large, but is no disc.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.augment import BALL_LABEL, FINE, blend
from operators.saliency.example import Example

MARKED_SHARE = 0.5  # of the people whose shirt has a mark
BADGE_SHARE = 0.5  # of the marks; others are numbers
BADGE, NUMBER, SCRAP = (0.02, 0.07), (0.09, 0.2), (0.015, 0.05)  # sizes over a person's height
LEAST_TALL_PX = 16.0  # nothing is to be seen on smaller people
SCRAPS = 1.5  # mean number in a picture
Picture = NDArray[np.uint8]  # (h, w, 3) RGB


def with_marks(example: Example, rng: np.random.Generator) -> Picture:
    """Return the picture with numbers and badges on shirts, and scraps where feet are."""
    picture = example.picture.copy()
    people = example.boxes[example.labels != BALL_LABEL]
    for left, top, right, bottom in people.tolist():
        tall = bottom - top
        if tall < LEAST_TALL_PX or rng.random() > MARKED_SHARE:
            continue
        x = left + (right - left) * rng.uniform(0.3, 0.7)
        y = top + tall * rng.uniform(0.2, 0.42)
        if rng.random() < BADGE_SHARE:
            _spot(picture, x, y, tall * rng.uniform(*BADGE), rng)
        else:
            _number(picture, x, y, tall * rng.uniform(*NUMBER), rng)
    if len(people):
        tall = float(np.median(people[:, 3] - people[:, 1]))
        feet = people[:, 3]
        low, high = float(feet.min()), float(feet.max()) + 0.5 * tall
        for _ in range(int(rng.poisson(SCRAPS))):
            x, y = rng.uniform(0, picture.shape[1]), rng.uniform(low, high)
            _spot(picture, x, y, max(tall * rng.uniform(*SCRAP), 1.0), rng)
    return picture


def _spot(picture: Picture, x: float, y: float, size_px: float, rng: np.random.Generator) -> None:
    """A round or angular spot, mostly white."""
    reach = int(np.ceil(size_px)) + 2
    cover = np.zeros(((2 * reach + 1) * FINE,) * 2, np.float32)
    middle = (x - int(x) + reach) * FINE, (y - int(y) + reach) * FINE
    sides = size_px * FINE, size_px * FINE * rng.uniform(0.6, 1.0)
    box = (middle, sides, float(rng.uniform(0, 180)))
    if rng.random() < 0.5:
        cv2.ellipse(cover, box, 1.0, -1)
    else:
        cv2.fillPoly(cover, [cv2.boxPoints(box).astype(np.int32)], 1.0)
    blend(picture, int(x) - reach, int(y) - reach, cover, cover, _ink(rng))


def _number(picture: Picture, x: float, y: float, high_px: float, rng: np.random.Generator) -> None:
    """One or two digits."""
    reach = int(np.ceil(high_px)) + 2
    cover = np.zeros(((2 * reach + 1) * FINE,) * 2, np.uint8)
    text, font = str(rng.integers(1, 100)), cv2.FONT_HERSHEY_SIMPLEX
    size = high_px * FINE / 21  # the font's digits are 21 pixels high
    thick = max(1, round(high_px * FINE * rng.uniform(0.12, 0.25)))
    (wide, high), _ = cv2.getTextSize(text, font, size, thick)
    middle = reach * FINE
    place = middle - wide // 2, middle + high // 2
    cv2.putText(cover, text, place, font, size, 255, thick, cv2.LINE_AA)
    light = np.asarray(cover / 255, np.float32)
    blend(picture, int(x) - reach, int(y) - reach, light, light, _ink(rng))


def _ink(rng: np.random.Generator) -> NDArray[np.float64]:
    if rng.random() < 0.6:
        return rng.uniform(170, 255) * (1 + rng.normal(size=3) * 0.05)
    return rng.uniform(0, 255, 3)
