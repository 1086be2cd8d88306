"""The tracked objects as one table: a row per object, To columns of history.

Every function takes a table and returns a new one, so that the table is also the state that
survives a swap.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from operators.association.kalman import MotionModel, predict, update
from pipeline.boxes import areas, centres, from_centres
from pipeline.messages import Detections

SIZE_GAIN = 0.3  # weight of a new width and height
SCORE_GAIN = 0.25  # weight of a new score; an undetected object scores 0
COLOUR_GAIN = 0.2  # weight of new colours
RELABEL_AFTER = 3  # detections of another class in succession before a track changes its class


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """All objects at frame `seq`; n may be 0. Boxes are sensor pixels."""

    seq: int
    next_id: int
    names: tuple[str, ...]
    ids: NDArray[np.int32]  # (n,), ascending
    labels: NDArray[np.int32]  # (n,)
    doubts: NDArray[np.int32]  # (n,), detections of another class in succession
    scores: NDArray[np.float32]  # (n,)
    hits: NDArray[np.int32]  # (n,), frames in which it was seen
    last_seq: NDArray[np.int64]  # (n,), when it was last seen
    mean: NDArray[np.float64]  # (n, 4): centre, velocity per frame
    covariance: NDArray[np.float64]  # (n, 2, 2), in box sizes
    size: NDArray[np.float32]  # (n, 2): width, height, smoothed
    boxes: NDArray[np.float32]  # (n, To, 4): as detected, or as the filter has it where unseen
    visible: NDArray[np.bool_]  # (n, To)
    features: NDArray[np.float32]  # (n, To, C): of the last sighting where unseen
    colours: NDArray[np.float32]  # (n, 2, 3), smoothed, CIELAB; not a number where unknown


ROWS = tuple(name for name in Table.__dataclass_fields__ if name not in ("seq", "next_id", "names"))


def empty(observed: int, channels: int, names: tuple[str, ...] = ()) -> Table:
    """A table without objects, before the first frame."""
    return Table(
        seq=-1,
        next_id=1,
        names=names,
        ids=np.zeros(0, np.int32),
        labels=np.zeros(0, np.int32),
        doubts=np.zeros(0, np.int32),
        scores=np.zeros(0, np.float32),
        hits=np.zeros(0, np.int32),
        last_seq=np.zeros(0, np.int64),
        mean=np.zeros((0, 4)),
        covariance=np.zeros((0, 2, 2)),
        size=np.zeros((0, 2), np.float32),
        boxes=np.zeros((0, observed, 4), np.float32),
        visible=np.zeros((0, observed), np.bool_),
        features=np.zeros((0, observed, channels), np.float32),
        colours=np.zeros((0, 2, 3), np.float32),
    )


def select(table: Table, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Table:
    """Return the table with these rows only."""
    return replace(table, **{name: getattr(table, name)[rows] for name in ROWS})


def advance(table: Table, seq: int, model: MotionModel) -> Table:
    """Return the table predicted for frame `seq`; the filter fills the frames between."""
    observed = table.boxes.shape[1]
    mean, covariance = table.mean, table.covariance
    boxes, visible = table.boxes, table.visible
    for _ in range(seq - table.seq):
        mean, covariance = predict(mean, covariance, model)
        filled = from_centres(mean[:, :2].astype(np.float32), table.size)
        boxes = np.concatenate([boxes[:, 1:], filled[:, None]], axis=1)
        visible = np.concatenate([visible[:, 1:], np.zeros((len(visible), 1), np.bool_)], axis=1)
    shift = np.minimum(np.arange(observed) + seq - table.seq, observed - 1)
    return replace(
        table,
        seq=seq,
        mean=mean,
        covariance=covariance,
        boxes=boxes,
        visible=visible,
        features=table.features[:, shift],
    )


def see(
    table: Table,
    pairs: NDArray[np.int64],
    detections: Detections,
    colours: NDArray[np.float32],
    model: MotionModel,
) -> Table:
    """Update matched rows: pairs (k, 2) of row and detection; other rows count as undetected.

    `colours` are those of the detections, (m, 2, 3).
    """
    row, seen = pairs[:, 0], pairs[:, 1]
    found = detections.boxes[seen]
    mean, covariance = table.mean.copy(), table.covariance.copy()
    mean[row], covariance[row] = update(
        mean[row], covariance[row], centres(found).astype(np.float64), model
    )
    scores, hits, last_seq = table.scores * (1 - SCORE_GAIN), table.hits.copy(), table.last_seq
    scores[row] += SCORE_GAIN * detections.scores[seen]
    hits[row] += 1
    last_seq = last_seq.copy()
    last_seq[row] = table.seq
    size = table.size.copy()
    size[row] += SIZE_GAIN * (found[:, 2:] - found[:, :2] - size[row])
    boxes, visible, features = table.boxes.copy(), table.visible.copy(), table.features.copy()
    boxes[row, -1], visible[row, -1], features[row, -1] = found, True, detections.features[seen]
    labels, doubts = relabelled(table.labels, table.doubts, row, detections.labels[seen])
    smooth = table.colours.copy()
    smooth[row] = smoothed(table.colours[row], colours[seen])
    return replace(
        table,
        names=detections.names,
        labels=labels,
        doubts=doubts,
        scores=scores,
        hits=hits,
        last_seq=last_seq,
        mean=mean,
        covariance=covariance,
        size=size,
        boxes=boxes,
        visible=visible,
        features=features,
        colours=smooth,
    )


def smoothed(old: NDArray[np.float32], new: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return colours after new ones were seen, (n, 2, 3): either alone where the other is unknown.

    >>> old, new = np.array([[10.0, np.nan, np.nan], [20.0, 20.0, np.nan]])
    >>> smoothed(old, new).tolist()
    [12.0, 20.0, nan]
    """
    known = np.where(np.isnan(old), new, old)
    return np.asarray(known + COLOUR_GAIN * np.nan_to_num(new - known), np.float32)


def relabelled(
    labels: NDArray[np.int32],
    doubts: NDArray[np.int32],
    row: NDArray[np.int64],
    seen: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return labels (n,) and doubts (n,) after rows (k,) were detected as labels (k,)."""
    labels, doubts = labels.copy(), doubts.copy()
    doubts[row] = np.where(labels[row] == seen, 0, doubts[row] + 1)
    convinced = doubts[row] >= RELABEL_AFTER
    labels[row[convinced]] = seen[convinced]
    doubts[row[convinced]] = 0
    return labels, doubts


def born(
    table: Table,
    fresh: NDArray[np.int64],
    detections: Detections,
    colours: NDArray[np.float32],
    model: MotionModel,
) -> Table:
    """Add one row per unmatched detection `fresh` (k,), with zero velocity.

    `colours` are those of the detections, (m, 2, 3).

    Earlier columns repeat its first box and features, marked as not visible.
    """
    count, observed = len(fresh), table.boxes.shape[1]
    found = detections.boxes[fresh]
    visible = np.zeros((count, observed), np.bool_)
    visible[:, -1] = True
    rows = {
        "ids": np.arange(table.next_id, table.next_id + count, dtype=np.int32),
        "labels": detections.labels[fresh],
        "doubts": np.zeros(count, np.int32),
        "scores": detections.scores[fresh],
        "hits": np.ones(count, np.int32),
        "last_seq": np.full(count, table.seq),
        "mean": np.concatenate([centres(found), np.zeros((count, 2))], axis=1),
        "covariance": np.tile(model.first, (count, 1, 1)),
        "size": found[:, 2:] - found[:, :2],
        "boxes": np.repeat(found[:, None], observed, axis=1),
        "visible": visible,
        "features": np.repeat(detections.features[fresh][:, None], observed, axis=1),
        "colours": colours[fresh],
    }
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(table, name), rows[name]]) for name in ROWS
    }
    return replace(table, next_id=table.next_id + count, **joined)


def box_sizes(table: Table) -> NDArray[np.float32]:
    """Root of each object's smoothed area: (n,), sensor pixels."""
    whole = np.concatenate([np.zeros_like(table.size), table.size], axis=1)
    return np.sqrt(areas(whole))
