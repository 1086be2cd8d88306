"""Pursue one object: find it, stay with it, wait for it where it was lost, search for it.

The rules that keep a small ball (false locks lose it, not prediction):

- A candidate must have been seen in `confirm` frames, and a rival must be better by a margin for
  `confirm` frames in succession, before the gaze changes. Moving candidates are preferred to still
  ones, and those outside people to those inside (see candidates.py).
- A target unseen for a few frames that was last near a person is carried by them: look there.
- Nobody near: look where it was foreseen last, and doubt more with every frame (the box grows);
  after `patience` frames visit the field window by window, nearest to the last place first.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from operators.policy.candidates import Sightings, count, nearest, none_seen, worth
from operators.policy.carrier import can_carry
from operators.policy.gaze_plan import GazePlan, follow, future, name_of, of_class, row_of, stay
from operators.policy.search import search
from operators.policy.target import BIND_IOU, GROWTH, TargetSpec
from pipeline import Tracks
from pipeline.boxes import centres, from_centres, iou, sizes

MARGIN = 0.2  # by how much a rival must be better, in score
COAST = 3  # frames a target may be unseen before a person near it counts as its carrier
CARRIER_REACH = 3.0  # box sizes between a target and a possible carrier


@dataclass(frozen=True, kw_only=True, eq=False)
class Pursuit:
    """What a pursuer remembers."""

    locked: int = -1  # track id
    target: str = ""  # class of what was locked
    seen_seq: int = -1  # when the target was last seen; -1: never
    box: NDArray[np.float32] = field(default_factory=lambda: np.zeros(4, np.float32))  # the last
    carrier_id: int = -1  # the person nearest to it when it was last seen
    rival: int = -1
    rival_frames: int = 0
    sightings: Sightings = field(default_factory=none_seen)


def pursue(
    tracks: Tracks, before: Pursuit, spec: TargetSpec, *, confirm: int, patience: int, horizon: int
) -> tuple[GazePlan, Pursuit]:
    """The plan for the frames after these tracks, and what to remember."""
    now = replace(before, sightings=count(before.sightings, tracks))
    now = locked_on(tracks, now, spec, confirm)
    row = row_of(tracks, now.locked)
    if row < 0:
        return wait(tracks, now, spec, patience=patience, horizon=horizon), now
    now = noted(tracks, row, now, spec)
    carrier = row_of(tracks, now.carrier_id)
    if tracks.header.seq - now.seen_seq > COAST and carrier >= 0:
        return stay(future(tracks, carrier, horizon), horizon), now
    return follow(tracks, row, horizon), now


def locked_on(tracks: Tracks, now: Pursuit, spec: TargetSpec, confirm: int) -> Pursuit:
    """Keep, gain or change the track that is the target."""
    if row_of(tracks, now.locked) >= 0:
        by_class = not spec.one
        return challenged(tracks, now, spec, confirm) if by_class else now
    row = first_lock(tracks, spec) if now.seen_seq < 0 else -1
    if row < 0 and (now.seen_seq >= 0 or not spec.one):
        row = regained(tracks, now, spec, confirm)
    locked = int(tracks.ids[row]) if row >= 0 else -1
    return replace(now, locked=locked, rival=-1, rival_frames=0)


def first_lock(tracks: Tracks, spec: TargetSpec) -> int:
    """Row of the object asked for by id or by box, -1 when it is not there."""
    if spec.object_id >= 0:
        return row_of(tracks, spec.object_id)
    if spec.boxed and len(tracks.ids):
        overlap = iou(tracks.boxes[:, -1], np.array([spec.box], np.float32))[:, 0]
        return int(overlap.argmax()) if overlap.max() >= BIND_IOU else -1
    return -1


def regained(tracks: Tracks, now: Pursuit, spec: TargetSpec, confirm: int) -> int:
    """Row of the best confirmed candidate, -1: none.

    One of many alike (asked for by id or by box) must be near where it was lost; the distance it
    may have gone grows with time. A class may turn up anywhere.
    """
    known = now.target if now.target else spec.label
    fit = of_class(tracks, known) & (now.sightings.counts >= confirm) & tracks.visible[:, -1]
    if spec.one:
        gone = tracks.header.seq - now.seen_seq
        away = np.linalg.norm(centres(tracks.boxes[:, -1]) - centres(now.box), axis=1)
        fit &= away <= (1 + GROWTH * gone) * sizes(now.box[None])
        value = -away.astype(np.float32)
    else:
        value = worth(tracks, can_carry(tracks, spec.carriers, known))
    return int(np.where(fit, value, -np.inf).argmax()) if fit.any() else -1


def challenged(tracks: Tracks, now: Pursuit, spec: TargetSpec, confirm: int) -> Pursuit:
    """Change to a rival that has been clearly better for `confirm` frames in succession."""
    fit = of_class(tracks, now.target or spec.label) & tracks.visible[:, -1]
    fit &= now.sightings.counts >= confirm
    own = row_of(tracks, now.locked)
    value = worth(tracks, can_carry(tracks, spec.carriers, now.target))
    best = int(np.where(fit, value, -np.inf).argmax())
    if not fit[best] or value[best] <= value[own] + MARGIN:
        return replace(now, rival=-1, rival_frames=0)
    rival = int(tracks.ids[best])
    frames = now.rival_frames + 1 if rival == now.rival else 1
    if frames < confirm:
        return replace(now, rival=rival, rival_frames=frames)
    return replace(now, locked=rival, rival=-1, rival_frames=0)


def noted(tracks: Tracks, row: int, now: Pursuit, spec: TargetSpec) -> Pursuit:
    """Remember where the target is, what it is and who is beside it."""
    box, target = tracks.boxes[row, -1], name_of(tracks, row)
    if not tracks.visible[row, -1]:
        # asked for while unseen: its absence counts from now
        return replace(
            now, box=box, seen_seq=now.seen_seq if now.seen_seq >= 0 else tracks.header.seq
        )
    rows = np.flatnonzero(can_carry(tracks, spec.carriers, target))
    at, _ = nearest(box, tracks.boxes[rows, -1], CARRIER_REACH * float(sizes(box[None])[0]))
    return replace(
        now,
        target=target,
        box=box,
        seen_seq=tracks.header.seq,
        carrier_id=int(tracks.ids[rows[at]]) if at >= 0 else -1,
    )


def wait(
    tracks: Tracks, now: Pursuit, spec: TargetSpec, *, patience: int, horizon: int
) -> GazePlan:
    """Where to look while there is no target: at its carrier, at its last place, all over."""
    carrier = row_of(tracks, now.carrier_id)
    if carrier >= 0:
        return stay(future(tracks, carrier, horizon), horizon)
    header = tracks.header
    if now.seen_seq < 0 and spec.boxed:
        return stay(np.array(spec.box, np.float32), horizon)
    frames = header.seq + 1 + np.arange(horizon) - now.seen_seq
    if now.seen_seq < 0:
        return stay(search(header.geometry, None, header.seq + 1 + np.arange(horizon)), horizon)
    side = (now.box[2:] - now.box[:2]) * (1 + GROWTH * frames[:, None])
    doubtful = from_centres(np.broadcast_to(centres(now.box), side.shape), side)
    places = search(header.geometry, centres(now.box), np.maximum(frames - patience - 1, 0))
    return stay(np.where((frames <= patience)[:, None], doubtful, places), horizon)
