"""What colour something has: a picture and boxes in, CIELAB out."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.boxes import Array, parts_of

Part = tuple[float, float, float, float]  # left, top, right, low: shares of a box
# of somebody who stands, whom most graphs follow; of other things they are two halves
TORSO: Part = (0.3, 0.18, 0.7, 0.48)
SHORTS: Part = (0.3, 0.5, 0.7, 0.66)
BRIGHTNESS = 0.5  # weight of a difference in brightness, because shadows change it


def colours(
    picture: NDArray[np.uint8], boxes: Array, parts: Sequence[Part] = (TORSO, SHORTS)
) -> NDArray[np.float64]:
    """Return the median colours of parts of boxes, (n, 4), pixels: (n, parts, 3), CIELAB of 8 bits.

    `picture` is (height, width, 3), RGB. A part outside of it is not a number.

    >>> grey = np.full((20, 10, 3), 128, np.uint8)
    >>> colours(grey, np.array([[0, 0, 10, 20]], np.float32)).tolist()
    [[[137.0, 128.0, 128.0], [137.0, 128.0, 128.0]]]
    """
    found = np.full((len(boxes), len(parts), 3), np.nan)
    sides = np.tile(picture.shape[1::-1], 2)
    known = np.nan_to_num(boxes, posinf=0, neginf=0)  # a wrong box has no colours
    for part, where in enumerate(parts):
        corners = np.clip(parts_of(known, where), 0, sides)
        corners[:, 2:] = np.ceil(corners[:, 2:])
        for row, (x0, y0, x1, y1) in enumerate(corners.astype(int)):
            patch = picture[y0:y1, x0:x1]
            if patch.size:
                values = cv2.cvtColor(np.ascontiguousarray(patch), cv2.COLOR_RGB2LAB)
                found[row, part] = _median(values.reshape(-1, 3))
    return found


def differences(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far colours (..., 3) are apart, which are broadcast: (...)."""
    return np.asarray(np.linalg.norm((a - b) * np.array([BRIGHTNESS, 1, 1]), axis=-1))


def _median(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return the median of each column: `np.median` takes five times as long for a few rows."""
    ordered = np.sort(values, 0).astype(np.float64)
    return np.asarray((ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2)
