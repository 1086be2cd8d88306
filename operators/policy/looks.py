"""What was shown at full resolution and what was read, per text: Tracks, ROI, Percept -> a table.

It is the inhibition of return of the policies that read: what was read is worth nothing more. A
text is known by its track and by its place: a track that begins where another one ended is the
same text, and a reading belongs to the tracks that it covers, whoever found them.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from operators.policy.readability import chances, heights
from pipeline import Geometry, Percept, Tracks
from pipeline.boxes import areas, centres, covered, intersections, iou
from pipeline.errors import MessageError

CAPACITY = 200  # texts; tracks first, then those whose track ended last
KEPT = 48  # frames for which a text without a track is kept
SAME_IOU = 0.2  # from which a new track is a text that was kept
INSIDE = 0.9  # share of a text that a window must show
COVERED = 0.5  # share of a track's box that a reading must cover
GROWN = 0.25  # of a reading's height, by which its box is grown: boxes of the context jitter
LATE = 32  # frames: older readings have no place any more
MOST_READINGS = 500
NEVER = -1
Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Looks:
    """One row per text as of frame `seq`: the current tracks in their order, then kept ones."""

    seq: int
    ids: NDArray[np.int32]  # (m,) of the track
    boxes: Array  # (m, 4) sensor pixels
    motion: Array  # (m, 2) of the centre, pixels per frame
    seen_seq: NDArray[np.int64]  # (m,) last frame with a track
    shown: NDArray[np.int32]  # (m,) frames in which a window showed it
    shown_seq: NDArray[np.int64]  # (m,) the last of them, NEVER
    tried: Array  # (m,) highest chance of reading it at which it was shown
    read: Array  # (m,) highest score of a reading of it, 0: none


def no_looks() -> Looks:
    """Return the table before the first frame."""
    whole, share = np.zeros(0, np.int64), np.zeros(0, np.float32)
    return Looks(
        seq=NEVER, ids=np.zeros(0, np.int32), boxes=np.zeros((0, 4), np.float32),
        motion=np.zeros((0, 2), np.float32), seen_seq=whole, shown=np.zeros(0, np.int32),
        shown_seq=whole, tried=share, read=share,
    )  # fmt: skip


def carried(before: Looks, tracks: Tracks) -> Looks:
    """Return the table of these tracks; new ones begin, or continue a text at their place."""
    seq, count = tracks.header.seq, len(tracks.ids)
    coasted = at(before, seq)
    rows = _rows(before, coasted, tracks)
    left = np.setdiff1d(np.arange(len(before.ids)), rows)
    field = tracks.header.geometry
    left = left[(seq - before.seen_seq[left] <= KEPT) & _in_field(coasted[left], field)]
    newest = np.argsort(-before.seen_seq[left], kind="stable")[: max(CAPACITY - count, 0)]
    left = left[np.sort(newest)]
    boxes = tracks.boxes[:, -1]
    motion = np.zeros((count, 2), np.float32)
    if tracks.predicted.shape[1]:
        motion = centres(tracks.predicted[:, 0]) - centres(boxes)

    def joined(old: NDArray[np.generic], new: float) -> NDArray[np.generic]:
        own = np.append(old, np.array([new], old.dtype))[rows]
        return np.concatenate([own, old[left]])

    return Looks(
        seq=seq,
        ids=np.concatenate([tracks.ids, before.ids[left]]),
        boxes=np.concatenate([boxes, coasted[left]]),
        motion=np.concatenate([motion, before.motion[left]]),
        seen_seq=np.concatenate([np.full(count, seq, np.int64), before.seen_seq[left]]),
        shown=joined(before.shown, 0),  # type: ignore[arg-type]
        shown_seq=joined(before.shown_seq, NEVER),  # type: ignore[arg-type]
        tried=joined(before.tried, 0),  # type: ignore[arg-type]
        read=joined(before.read, 0),  # type: ignore[arg-type]
    )


def at(looks: Looks, seq: int) -> Array:
    """Return the boxes (m, 4) as of frame `seq`, moved at constant velocity."""
    moved = np.tile(looks.motion * np.float32(seq - looks.seq), 2)
    return np.asarray(looks.boxes + moved, np.float32)


def exposed(looks: Looks, window: Array, seq: int) -> Looks:
    """Return the table after the ROI showed `window` (4,) in frame `seq`."""
    boxes = at(looks, seq)
    inside = covered(boxes, np.asarray(window, np.float32)) >= INSIDE
    chance = np.where(inside, chances(heights(boxes)), 0)
    return replace(
        looks,
        shown=looks.shown + inside.astype(np.int32),
        shown_seq=np.where(inside, np.maximum(looks.shown_seq, seq), looks.shown_seq),
        tried=np.maximum(looks.tried, chance).astype(np.float32),
    )


def noted(looks: Looks, percept: Percept) -> Looks:
    """Return the table after the reader reported what it has read; raises `MessageError`.

    Readings without a text are none.
    """
    if percept.texts and len(percept.texts) != len(percept.boxes):
        got = f"{len(percept.texts)} for {len(percept.boxes)} boxes"
        raise MessageError(f"policy.percept.texts: expected one for each box, got {got}")
    boxes, scores = percept.boxes[:MOST_READINGS], percept.scores[:MOST_READINGS]
    valid = np.isfinite(boxes).all(1) & np.isfinite(scores)
    if percept.texts:
        valid &= np.array([bool(text) for text in percept.texts[:MOST_READINGS]], np.bool_)
    if not valid.any() or not len(looks.ids) or abs(looks.seq - percept.header.seq) > LATE:
        return looks
    boxes, scores = boxes[valid], np.clip(scores[valid], 0, 1)
    slack = GROWN * heights(boxes)[:, None]
    grown = np.concatenate([boxes[:, :2] - slack, boxes[:, 2:] + slack], 1)
    own = at(looks, percept.header.seq)
    share = intersections(own, grown) / np.maximum(areas(own), 1e-9)[:, None]
    best = np.where(share >= COVERED, scores, 0).max(1)
    return replace(looks, read=np.maximum(looks.read, best).astype(np.float32))


def _rows(before: Looks, coasted: Array, tracks: Tracks) -> NDArray[np.intp]:
    """Return the row of each track (n,) in the table, -1 for a new text; no row twice."""
    known = {int(i): row for row, i in enumerate(before.ids)}
    rows = np.array([known.get(int(i), -1) for i in tracks.ids], np.intp)
    free = np.setdiff1d(np.arange(len(before.ids)), rows)
    fresh = np.flatnonzero(rows < 0)
    if not len(free) or not len(fresh):
        return rows
    shared = iou(tracks.boxes[fresh, -1], coasted[free])
    for place in np.argsort(-shared.max(1), kind="stable"):
        best = int(shared[place].argmax())
        if shared[place, best] >= SAME_IOU:
            rows[fresh[place]] = free[best]
            shared[:, best] = 0
    return rows


def _in_field(boxes: Array, field: Geometry) -> NDArray[np.bool_]:
    """Return which boxes (m, 4) have their centre inside the field; all without a geometry."""
    if not field.width_px:
        return np.ones(len(boxes), np.bool_)
    x, y = centres(boxes).T
    return np.asarray((x >= 0) & (y >= 0) & (x <= field.width_px) & (y <= field.height_px))
