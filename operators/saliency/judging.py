"""Judge detections by the truth: boxes and true boxes -> hits -> precision and recall."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.boxes import centres, iou

LEAST_IOU = 0.5
BALL_REACH_PX = 6.0  # of the context, between centres
FLOOR = 0.02  # confidence at which curves begin


@dataclass(frozen=True, kw_only=True, eq=False)
class Tally:
    """Detections of one class over many pictures, and how many there were to find."""

    scores: NDArray[np.float32]  # (n,)
    hits: NDArray[np.bool_]  # (n,)
    present: int


def find_hits(
    boxes: NDArray[np.float32],
    truth: NDArray[np.float32],
    ignored: NDArray[np.bool_],
    *,
    by_centre: bool = False,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which detections of one class, best first, are hits, and which count at all.

    Each true box is hit once, by the best detection that fits; what fits only an ignored box does
    not count. Fitting is IoU >= 0.5, or a centre within `BALL_REACH_PX` (pixels of the boxes).
    """
    if not len(boxes) or not len(truth):
        return np.zeros(len(boxes), np.bool_), np.ones(len(boxes), np.bool_)
    if by_centre:
        away = np.linalg.norm(centres(boxes)[:, None] - centres(truth)[None], axis=2)
        return assigned(np.where(away <= BALL_REACH_PX, 1 + BALL_REACH_PX - away, 0), ignored)
    overlap = iou(boxes, truth)
    return assigned(np.where(overlap >= LEAST_IOU, overlap, 0), ignored)


def assigned(
    fit: NDArray[np.floating], ignored: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Hits, and what counts at all, by how well detections, best first, fit truths: (n, m).

    0 where one does not fit.
    """
    hits = matched(fit, ~ignored) >= 0
    return hits, hits | ~((fit > 0) & ignored).any(1)


def matched(fit: NDArray[np.floating], free: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Which of the free truths (m,) each detection hits, by how well it fits: (n, m) -> (n,).

    The best of those that no better detection hit; -1 for none.
    """
    hit, free = np.full(len(fit), -1, np.intp), free.copy()
    for row, chances in enumerate(fit if fit.shape[1] else ()):
        open_ones = chances * free
        if open_ones.max() > 0:
            hit[row] = open_ones.argmax()
            free[hit[row]] = False
    return hit


def at_threshold(tally: Tally, threshold: float) -> dict[str, float]:
    """Precision and recall of what reaches a confidence; 0 where nothing does."""
    taken = tally.scores >= threshold
    hits = int(tally.hits[taken].sum())
    return {
        "precision": hits / max(1, int(taken.sum())),
        "recall": hits / max(1, tally.present),
        "present": tally.present,
    }


def curve(tally: Tally) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Falling thresholds, and precision and recall at each."""
    order = np.argsort(-tally.scores, kind="stable")
    hits = np.cumsum(tally.hits[order])
    precision = hits / np.arange(1, len(order) + 1)
    recall = hits / max(1, tally.present)
    return tally.scores[order], precision.astype(np.float32), recall.astype(np.float32)


def average_precision(tally: Tally) -> float:
    """Area under the precision-recall curve, precision made monotonous first."""
    _, precision, recall = curve(tally)
    if not len(precision):
        return 0.0
    best = np.maximum.accumulate(precision[::-1])[::-1]
    return float((best * np.diff(recall, prepend=0)).sum())


def best_threshold(tally: Tally) -> float:
    """The confidence of the greatest F1, rounded down to a hundredth."""
    thresholds, precision, recall = curve(tally)
    if not len(thresholds):
        return 0.5
    f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-9)
    return max(FLOOR, round(float(np.floor(thresholds[f1.argmax()] * 100)) / 100, 2))
