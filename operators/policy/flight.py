"""A lost target that was kicked: it flies straight away from where it was last seen.

What flies is blurred, so that the context rates it low and a look would refute it. How it moves
tells it from what lies there or runs about: straight away from that place, fast, and at nobody's
feet. People who are looked for are not kicked. The place is not moved with the camera: a ball that
is slower than the camera turns is not recognised.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from operators.policy.carrier import can_carry
from operators.policy.gaze_plan import PLACE, of_class, row_of
from operators.policy.motion import common
from operators.policy.target import TargetSpec
from pipeline import Tracks
from pipeline.boxes import centres, sizes

# how far it may be from where the target was last seen: at once, and for each frame since
REACH_PX, STEP_PX = 60.0, 30.0
STRAIGHT = 0.8  # least cosine of the angle between its motion and the way from there
LEAST_SPEED = 0.5  # of its size in each frame
SLOW = 0.25  # of its size in each frame, below which it has come down
LONGEST = 100  # frames that a flight may take
Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Flight:
    """The track that is followed on its way."""

    track_id: int = PLACE
    since_seq: int = -1  # frame in which it began
    over: bool = False  # no other begins before the target is found again


def next_flight(
    tracks: Tracks, before: Flight, spec: TargetSpec, place: Array, lost: int
) -> Flight:
    """Return the flight that goes on, begins or is over.

    `lost` frames ago the target was last seen at `place` (4,), xyxy in pixels of the sensor.
    """
    if before.over or spec.label in spec.carriers:
        return before
    if before.track_id != PLACE:
        return before if goes_on(tracks, before, spec) else Flight(over=True)
    row = begun(tracks, spec, place, lost)
    if row < 0:
        return before
    return Flight(track_id=int(tracks.ids[row]), since_seq=tracks.header.seq)


def goes_on(tracks: Tracks, flight: Flight, spec: TargetSpec) -> bool:
    """Whether a flight is still to be followed."""
    row = row_of(tracks, flight.track_id)
    if row < 0 or tracks.header.seq - flight.since_seq >= LONGEST:
        return False
    fast = np.linalg.norm(motion(tracks)[row]) >= SLOW * sizes(tracks.boxes[row : row + 1, -1])[0]
    return bool(fast and tracks.visible[row].any() and of_class(tracks, spec.label)[row])


def begun(tracks: Tracks, spec: TargetSpec, place: Array, lost: int) -> int:
    """Return the row of the surest of what may have left `place` (4,) `lost` frames ago; or -1.

    It is seen in every observed frame, has left the place, and is no farther away than a kicked
    ball gets.
    """
    step, way = motion(tracks), centres(tracks.boxes[:, -1]) - centres(place)
    speed, away = np.linalg.norm(step, axis=1), np.linalg.norm(way, axis=1)
    size = sizes(tracks.boxes[:, -1])
    fit = of_class(tracks, spec.label) & tracks.visible.all(1) & ~at_somebody(tracks, spec)
    fit &= (away >= size) & (away <= REACH_PX + STEP_PX * lost)
    fit &= (speed >= LEAST_SPEED * size) & ((step * way).sum(1) >= STRAIGHT * speed * away)
    return int(np.where(fit, tracks.scores, -1).argmax()) if fit.any() else -1


def motion(tracks: Tracks) -> Array:
    """Return how far each track moves in a frame, less the camera's motion: (n, 2), pixels."""
    path = centres(tracks.boxes)
    step = (path[:, -1] - path[:, 0]) / max(path.shape[1] - 1, 1)
    return np.asarray(step - common(step[np.isfinite(step).all(1)]), np.float32)


def at_somebody(tracks: Tracks, spec: TargetSpec) -> NDArray[np.bool_]:
    """Return which tracks have their centre inside the box of a person in view, as boots have."""
    people = can_carry(tracks, spec.carriers, spec.label) & tracks.visible[:, -1]
    middles, boxes = centres(tracks.boxes[:, -1])[:, None], tracks.boxes[people, -1][None]
    return np.asarray(((middles >= boxes[..., :2]) & (middles <= boxes[..., 2:])).all(2).any(1))
