"""Match detections to tracks: predicted and detected boxes -> pairs of indices."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from pipeline.boxes import centres, iou

Pairs = NDArray[np.int64]  # (k, 2): track, detection
Rows = NDArray[np.intp]
# tracks (k,) and detections (k,) -> how alike each pair is (k,), above 0 to 1
Likeness = Callable[[Rows, Rows], NDArray[np.float32]]


def match(
    predicted: NDArray[np.float32],  # (n, 4), sensor pixels
    detected: NDArray[np.float32],  # (m, 4), sensor pixels
    same: NDArray[np.bool_],  # (n, m): of one class
    *,
    iou_gate: float,
    reach_px: NDArray[np.float32],  # (n,): distance limit of small objects, 0: not small
    likeness: Likeness | None = None,  # of the colours of pairs
) -> Pairs:
    """Pair tracks with detections, each at most once; (k, 2) indices, ordered by track.

    Overlap is multiplied by the likeness of colours, so that people who cross keep their tracks.

    The same class is matched first by overlap, then by distance for objects too small to overlap,
    then across classes by overlap. Distance precedes a change of class: a ball that left its box is
    more likely than a ball that became a boot.
    """
    if not len(predicted) or not len(detected):
        return np.zeros((0, 2), np.int64)
    overlap = iou(predicted, detected)
    overlapping = overlap >= iou_gate
    if likeness is not None:
        overlap[overlapping] *= likeness(*np.nonzero(overlapping))
    found = [assign(overlap, overlapping & same)]
    if reach_px.any():
        nearness = near(predicted, detected, reach_px)
        found.append(assign(nearness, free(found, (nearness > 0) & same)))
    found.append(assign(overlap, free(found, overlapping & ~same)))
    pairs = np.concatenate(found)
    return np.asarray(pairs[np.argsort(pairs[:, 0])])


def assign(value: NDArray[np.float32], allowed: NDArray[np.bool_]) -> Pairs:
    """The pairs of greatest total value (Hungarian algorithm) among the allowed: (n, m) -> (k, 2).

    `value` is positive wherever a pair is allowed.

    >>> assign(np.array([[0.9, 0.8], [0.7, 0.0]], np.float32), np.ones((2, 2), bool)).tolist()
    [[0, 1], [1, 0]]
    """
    if not allowed.any():
        return np.zeros((0, 2), np.int64)
    # most detections compete with at most one other: solve only rows and columns with a choice
    rows, columns = np.flatnonzero(allowed.any(1)), np.flatnonzero(allowed.any(0))
    part = np.ix_(rows, columns)
    row, column = linear_sum_assignment(np.where(allowed[part], value[part], 0), maximize=True)
    pairs = np.stack([rows[row], columns[column]], 1)
    return np.asarray(pairs[allowed[pairs[:, 0], pairs[:, 1]]], np.int64)


def near(
    predicted: NDArray[np.float32], detected: NDArray[np.float32], reach_px: NDArray[np.float32]
) -> NDArray[np.float32]:
    """1 where centres coincide, falling to 0 at the track's reach: (n, 4), (m, 4), (n,) -> (n, m).

    0 for a detection more than twice or less than half as wide or high.
    """
    away = centres(predicted)[:, None] - centres(detected)[None]
    distance = np.hypot(away[..., 0], away[..., 1])
    side = predicted[:, 2:] - predicted[:, :2]
    other = detected[:, 2:] - detected[:, :2]
    less, more = np.minimum(side[:, None], other[None]), np.maximum(side[:, None], other[None])
    alike = (more <= 2 * less).all(-1)  # no ratio: a side may be 0 or negative
    closeness = 1 - distance / np.maximum(reach_px, 1e-6)[:, None]
    return np.asarray(np.where(alike, np.maximum(closeness, 0), 0), np.float32)


def free(found: list[Pairs], allowed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """What is allowed and not yet paired: (n, m) -> (n, m)."""
    left = allowed.copy()
    for pairs in found:
        left[pairs[:, 0]] = False
        left[:, pairs[:, 1]] = False
    return left
