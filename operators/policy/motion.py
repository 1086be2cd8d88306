"""What all tracks have in common: the camera's motion, as far as they tell it."""

import numpy as np

from operators.policy.tokens import Array
from pipeline import Tracks
from pipeline.boxes import centres

WITNESSES = 4  # tracks needed before their median motion is believed to be the camera's


def common(motion: Array) -> Array:
    """The median of the tracks' motion (n, 2): (2,), zero where too few testify."""
    if len(motion) < WITNESSES:
        return np.zeros(2, np.float32)
    return np.asarray(np.median(motion, axis=0), np.float32)


def camera_motion(tracks: Tracks) -> Array:
    """By how much the picture moves to the next frame: (2,) sensor pixels."""
    if not tracks.predicted.shape[1]:
        return np.zeros(2, np.float32)
    return common(centres(tracks.predicted[:, 0]) - centres(tracks.boxes[:, -1]))
