"""Chance that a reader reads a text in the ROI: boxes -> chances.

Measured with PP-OCR on windows of 320x180 of the street scene (seeds 200 to 215, 641 looks at
visible texts that are legible at some time, upright boxes): nothing is read below 5 pixels, most
texts of 7, and what is not read above 19 is lettered too closely or cut by the window's edge.
"""

import numpy as np
from numpy.typing import NDArray

HEIGHTS_PX = (5.0, 6.5, 8.0, 16.0, 19.0)
SHARES = (0.0, 0.6, 0.7, 0.77, 0.92)  # read rightly, of texts of these heights
Array = NDArray[np.float32]


def heights(boxes: Array) -> Array:
    """Return the height of the text in each box (..., 4), its shorter side: (...), pixels."""
    return np.asarray(np.maximum((boxes[..., 2:] - boxes[..., :2]).min(-1), 0), np.float32)


def chances(height_px: Array) -> Array:
    """Return the chance that a text of each height (...) is read in one look: (...), 0..1.

    >>> chances(np.array([4, 7, 40], np.float32)).round(2).tolist()
    [0.0, 0.6299999952316284, 0.9200000166893005]
    """
    return np.asarray(np.interp(height_px, HEIGHTS_PX, SHARES), np.float32)
