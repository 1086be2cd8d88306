"""Chance that a reader reads a text in the ROI: boxes -> chances.

A logistic curve in the height of the text in pixels of full resolution. Its two points are those
of `HALF_PX` and `MOST_PX`.
"""

import numpy as np
from numpy.typing import NDArray

HALF_PX, MOST_PX, MOST = 9.0, 14.0, 0.9  # read by half at HALF_PX, by MOST at MOST_PX
STEEPNESS = float(np.log(MOST / (1 - MOST)) / (MOST_PX - HALF_PX))
Array = NDArray[np.float32]


def heights(boxes: Array) -> Array:
    """Return the height of the text in each box (..., 4), its shorter side: (...), pixels."""
    return np.asarray(np.maximum((boxes[..., 2:] - boxes[..., :2]).min(-1), 0), np.float32)


def chances(height_px: Array) -> Array:
    """Return the chance that a text of each height (...) is read in one look: (...), 0..1.

    >>> chances(np.array([9, 14, 40], np.float32)).round(2).tolist()
    [0.5, 0.8999999761581421, 1.0]
    """
    steps = np.clip(STEEPNESS * (height_px - HALF_PX), -30, 30)
    return np.asarray(1 / (1 + np.exp(-steps)), np.float32)
