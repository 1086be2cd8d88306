"""The carrier of a target: a ball in a person's hands moves with them, not as predicted.

A target last seen in the upper part of a person's box counts as carried; at the feet it may be
kicked or left behind.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from operators.policy.gaze_plan import of_class
from pipeline import Tracks
from pipeline.boxes import centres

PEOPLE = ("player", "goalkeeper", "referee", "person")
UPPER_PART = 0.75  # share of a person's height, from the top; anything lower is at the feet
LARGEST = 0.5  # of the person's height; a larger object is not carried
Array = NDArray[np.float32]


def can_carry(tracks: Tracks, people: Sequence[str], target: str) -> NDArray[np.bool_]:
    """Return which tracks can carry a target of that class: (n,). People do not carry people."""
    could = np.zeros(len(tracks.ids), np.bool_)
    if target not in people:
        for name in people:
            could |= of_class(tracks, name)
    return could


def carrier_of(box: Array, tracks: Tracks, could: NDArray[np.bool_]) -> int:
    """Return the id of the nearest person whose upper part contains `box`'s centre; -1: none.

    Only people detected in this frame count, because a predicted box is unreliable.
    """
    rows = np.flatnonzero(could & tracks.visible[:, -1])
    people, (x, y) = tracks.boxes[rows, -1], centres(box)
    reach = people[:, 1] + UPPER_PART * (people[:, 3] - people[:, 1])
    inside = (people[:, 0] <= x) & (x <= people[:, 2]) & (people[:, 1] <= y) & (y <= reach)
    inside &= box[3] - box[1] < LARGEST * (people[:, 3] - people[:, 1])
    if not inside.any():
        return -1
    away = np.abs(centres(people)[:, 0] - x)
    return int(tracks.ids[rows[np.where(inside, away, np.inf).argmin()]])


def carried_motion(tracks: Tracks, row: int) -> tuple[Array, Array]:
    """Return past and future motion of what a track carries: (To, 2), (Tp, 2), relative pixels."""
    here = centres(tracks.boxes[row, -1])
    return centres(tracks.boxes[row]) - here, centres(tracks.predicted[row]) - here
