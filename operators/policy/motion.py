"""Camera motion, estimated as the common motion of all tracks."""

import numpy as np

from operators.policy.tokens import Array
from pipeline import Tracks
from pipeline.boxes import centres

WITNESSES = 4  # tracks needed for an estimate


def common(motion: Array) -> Array:
    """Return the median motion of tracks (n, 2): (2,), zero for too few tracks."""
    if len(motion) < WITNESSES:
        return np.zeros(2, np.float32)
    return np.asarray(np.median(motion, axis=0), np.float32)


def camera_motion(tracks: Tracks) -> Array:
    """Return the motion of the picture to the next frame: (2,) sensor pixels."""
    if not tracks.predicted.shape[1]:
        return np.zeros(2, np.float32)
    return common(centres(tracks.predicted[:, 0]) - centres(tracks.boxes[:, -1]))
