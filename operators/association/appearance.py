"""What objects look like in the context: colours, and how alike they are."""

import numpy as np
from numpy.typing import NDArray

from pipeline import Frame
from pipeline.boxes import in_picture
from pipeline.colours import colours, differences

LEAST_PX = 6.0  # height in the picture: of what is smaller, as a ball, colours are the lawn's
MOST_UNLIKE = 50.0  # limits the exponent, so that likeness stays above 0, as `assign` needs it
Array = NDArray[np.float32]


def worn(boxes: Array, frame: Frame | None) -> Array:
    """Return the colours of torso and shorts of boxes (n, 4), sensor pixels: (n, 2, 3), CIELAB.

    They are not numbers where nothing is known: without a picture, in one without colours, and of
    what is too small. Of other things than people they are those of upper and lower half.
    """
    found = np.full((len(boxes), 2, 3), np.nan, np.float32)
    if frame is None or frame.pixel_format != "rgb8":
        return found
    own = in_picture(boxes, frame)
    large = own[:, 3] - own[:, 1] >= LEAST_PX
    found[large] = colours(np.asarray(frame.pixels, np.uint8), own[large])
    return found


def likeness(known: Array, seen: Array, difference: float) -> Array:
    """Return how alike the colours of pairs are, (n, 2, 3) and (n, 2, 3): (n,), above 0 to 1.

    1 where either is unknown, exp(-1) where one part differs by `difference`, in CIELAB.
    """
    apart = differences(known.astype(np.float64), seen.astype(np.float64))
    unlike = np.nan_to_num((apart / difference) ** 2).sum(-1)
    return np.asarray(np.exp(-np.minimum(unlike, MOST_UNLIKE)), np.float32)
