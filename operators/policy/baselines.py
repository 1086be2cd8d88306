"""Strategies that learn nothing and look at nobody in particular: the paper's baselines."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from operators.policy.gaze_plan import GazePlan, field_centre, future, of_class, stay
from pipeline import Tracks


@dataclass(frozen=True, kw_only=True)
class Turn:
    """Whose turn it is in the round, and since which frame."""

    object_id: int = -1
    since_seq: int = -1


def centred(tracks: Tracks, horizon: int) -> GazePlan:
    """Always the middle of the field."""
    return stay(field_centre(tracks.header.geometry), horizon)


def round_robin(
    tracks: Tracks, turn: Turn, *, target: str, dwell: int, horizon: int
) -> tuple[GazePlan, Turn]:
    """Each object in turn, by id, `dwell` frames each; `target` limits the round to one class.

    The turn passes to the next higher id, so that objects may come and go without disturbing the
    round. Without objects it is the middle of the field.
    """
    rows = np.flatnonzero(of_class(tracks, target))
    if not len(rows):
        return centred(tracks, horizon), Turn()
    ids = tracks.ids[rows]
    now = tracks.header.seq + 1
    if turn.object_id < 0:
        turn = Turn(object_id=int(ids[0]), since_seq=now)
    elif turn.object_id not in ids or now - turn.since_seq >= dwell:
        turn = Turn(object_id=int(ids[after(ids, turn.object_id)]), since_seq=now)
    first = int(np.flatnonzero(ids == turn.object_id)[0])
    frames = np.arange(horizon)
    places = (first + (now - turn.since_seq + frames) // dwell) % len(rows)
    boxes = np.stack([future(tracks, int(row), horizon) for row in rows])
    return GazePlan(choice=ids[places], boxes=boxes[places, frames]), turn


def after(ids: NDArray[np.int32], last: int) -> int:
    """Index of the next higher id than `last`, or 0 at the end of the round; ids ascending.

    >>> after(np.array([2, 5, 9], np.int32), 5), after(np.array([2, 5, 9], np.int32), 9)
    (2, 0)
    """
    return int(np.searchsorted(ids, last, side="right")) % len(ids)
