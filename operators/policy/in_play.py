"""Which candidates for a small target are in play: Tracks and places at rest -> odds per track.

Before a camera that shows a whole pitch most of what looks like a ball is scenery: heads in the
stands, letters on boards, corner flags, penalty spots, spare balls beside the pitch. What is in
play moves, or a person is near it and it has not lain there for long. In 750 frames of a real match
(SoccerTrack: boxes of the ball and of 22 players) the ball is in play in all of them by these
numbers, and never at rest for more than 123 frames.

The camera stands still: where it moves everything does, and the rule says nothing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from operators.policy.carrier import PEOPLE, can_carry
from operators.policy.gaze_plan import of_class
from operators.policy.target import TargetSpec
from pipeline import Tracks
from pipeline.boxes import centres, sizes

NEAR = 0.7  # of a person's height, between the middles of both: a ball at the feet is at .5
MOVED = 0.15  # of its size in each frame; what stands still is detected at the same place
RESTED = 240  # frames at rest, 8 s at 30 Hz, after which a candidate is scenery until it moves
FORGOTTEN = 24  # frames without a candidate at rest after which a place is forgotten
CAPACITY = 400  # places
# What being in play or not adds to the odds that a candidate is a ball, in nats: of the balls on
# two sets of ten drawn pitches .996 and 1.0 are in play, of the other candidates .08 and .05.
IN_PLAY, SCENERY = 2.6, -5.0
Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """Where candidates are at rest."""

    at: Array  # (m, 2) sensor pixels
    since_seq: NDArray[np.int64]  # (m,)
    seen_seq: NDArray[np.int64]  # (m,) the last frame with a candidate at rest there


def no_places() -> Places:
    """Return the places before the first frame."""
    none = np.zeros(0, np.int64)
    return Places(at=np.zeros((0, 2), np.float32), since_seq=none, seen_seq=none)


def tells(spec: TargetSpec) -> bool:
    """Whether rest tells something of this target: any of a class that people handle."""
    people = {*PEOPLE, *spec.carriers}
    return bool(spec.label and spec.carriers and not spec.one and spec.label not in people)


def places_after(before: Places, tracks: Tracks, spec: TargetSpec) -> Places:
    """Return the places after one more frame; the ones seen longest ago are dropped first."""
    seq = tracks.header.seq
    resting = of_class(tracks, spec.label) & tracks.visible[:, -1] & ~moves(tracks)
    boxes = tracks.boxes[resting, -1]
    same = at_places(boxes, before)
    new = centres(boxes[~same.any(1)])
    now = np.full(len(new), seq)
    at = np.concatenate([before.at, new])
    since_seq = np.concatenate([before.since_seq, now])
    seen_seq = np.concatenate([np.where(same.any(0), seq, before.seen_seq), now])
    newest = np.argsort(-seen_seq, kind="stable")[:CAPACITY]
    kept = np.sort(newest[seq - seen_seq[newest] <= FORGOTTEN])
    return Places(at=at[kept], since_seq=since_seq[kept], seen_seq=seen_seq[kept])


def at_places(boxes: Array, places: Places) -> NDArray[np.bool_]:
    """Return which candidates (n, 4) are at which places, no farther than their size: (n, m)."""
    middles = centres(boxes)  # one axis at a time: an innermost axis of two takes ten times as long
    x = middles[:, 0, None] - places.at[:, 0]
    y = middles[:, 1, None] - places.at[:, 1]
    return np.asarray(x * x + y * y < sizes(boxes)[:, None] ** 2, np.bool_)


def moves(tracks: Tracks) -> NDArray[np.bool_]:
    """Return which tracks have moved over the frames that are known of them: (n,)."""
    path = centres(tracks.boxes)
    step = (path[:, -1] - path[:, 0]) / max(path.shape[1] - 1, 1)
    return np.asarray(np.hypot(*step.T) >= MOVED * sizes(tracks.boxes[:, -1]), np.bool_)


def near_somebody(tracks: Tracks, spec: TargetSpec) -> NDArray[np.bool_]:
    """Return which tracks have a person near who was seen in one of their frames: (n,)."""
    boxes = tracks.boxes[:, -1]
    people = boxes[can_carry(tracks, spec.carriers, spec.label) & tracks.visible.any(1)]
    away = np.linalg.norm(centres(boxes)[:, None] - centres(people)[None], axis=2)
    return np.asarray((away < NEAR * (people[:, 3] - people[:, 1])).any(1), np.bool_)


def in_play(tracks: Tracks, spec: TargetSpec, places: Places) -> NDArray[np.bool_]:
    """Return which tracks move, or have a person near and are not at rest for long: (n,)."""
    old = tracks.header.seq - places.since_seq >= RESTED
    scenery = (at_places(tracks.boxes[:, -1], places) & old).any(1)
    return np.asarray(moves(tracks) | (near_somebody(tracks, spec) & ~scenery), np.bool_)


def play_odds(tracks: Tracks, spec: TargetSpec, places: Places) -> Array:
    """Return what being in play adds to the logarithm of the odds of each track: (n,)."""
    return np.where(in_play(tracks, spec, places), np.float32(IN_PLAY), np.float32(SCENERY))
