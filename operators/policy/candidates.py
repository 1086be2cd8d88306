"""Rate tracks as candidates for the target: tracks -> numbers per track."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import Tracks
from pipeline.boxes import centres

# Of the odds, in nats: bias, gain of the score and of what the ROI showed, by class. Logistic
# regressions over what the shipped detector and encoder say of stills of one match (2,136 balls, 28
# of them right, 788 players, 83 referees); see operators/roi_features/CARD.md.
WEIGHTS = {"ball": (-1.1, 2.3, 0.6), "player": (2.8, 0.9, 0.8), "referee": (2.3, 1.9, 0.8)}
USUAL = WEIGHTS["ball"]  # of other classes
# Of the odds that a faint candidate is a ball, in nats: bias and gain of the score in the context,
# before the ROI showed it and afterwards; regressions of bench.second_look.
UNSEEN, SEEN = (0.66, 3.87), (0.02, 1.9)
# where shares are clipped; a verdict, which joins two clipped ones, less
LEAST, LEAST_VERDICT = 0.005, 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Sightings:
    """Number of frames with a detection of each current track."""

    ids: NDArray[np.int32]  # (n,)
    counts: NDArray[np.int32]  # (n,)


def none_seen() -> Sightings:
    """Return empty counts."""
    return Sightings(ids=np.zeros(0, np.int32), counts=np.zeros(0, np.int32))


def count(before: Sightings, tracks: Tracks) -> Sightings:
    """Add a frame. A new track counts the detections in its history, at most To frames."""
    history = tracks.visible.sum(axis=1).astype(np.int32)
    known = {int(i): int(c) for i, c in zip(before.ids, before.counts, strict=True)}
    counts = [
        known[int(i)] + int(now) if int(i) in known else int(past)
        for i, now, past in zip(tracks.ids, tracks.visible[:, -1], history, strict=True)
    ]
    return Sightings(ids=tracks.ids, counts=np.array(counts, np.int32))


def odds(tracks: Tracks, shown: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the logarithm of the odds that each track is of its class: (n,).

    From its score and what the ROI showed of it (`shown`, 0..1 at even odds, 0.5: nothing).
    """
    by_class = np.array([WEIGHTS.get(name, USUAL) for name in tracks.names] or [USUAL])
    bias, of_score, of_shown = by_class[np.clip(tracks.labels, 0, len(by_class) - 1)].T
    found = bias + of_score * logit(tracks.scores) + of_shown * logit(shown)
    return np.asarray(found, np.float32)


def faint_odds(
    scores: NDArray[np.float32], shown: NDArray[np.float32], seen: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Return the logarithm of the odds that each faint candidate is a ball: (n,).

    From its score in the context and, where the ROI showed it (`seen`), the probability at even
    odds that `operators.verify` has of it (`shown`).
    """
    after = logit(scores) * SEEN[1] + SEEN[0] + logit(shown, LEAST_VERDICT)
    return np.asarray(np.where(seen, after, context_odds(scores)), np.float32)


def context_odds(scores: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the logarithm of the odds of each candidate by the context alone: (n,)."""
    return np.asarray(logit(scores) * UNSEEN[1] + UNSEEN[0], np.float32)


def probability(odds: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the probability of logarithms of odds."""
    return np.asarray(1 / (1 + np.exp(-odds)), np.float32)


def logit(share: NDArray[np.float32], least: float = LEAST) -> NDArray[np.float64]:
    """Return the logarithm of the odds; shares are clipped to `least` .. 1 - `least`."""
    kept = np.clip(share.astype(np.float64), least, 1 - least)
    return np.asarray(np.log(kept / (1 - kept)))


def nearest(
    box: NDArray[np.float32], others: NDArray[np.float32], reach_px: float
) -> tuple[int, float]:
    """Return index and distance of the nearest of `others` (n, 4) to the centre of `box` (4,).

    The distance is to the edge, 0 inside; the index is -1 when none is within reach.

    >>> near = np.array([[0, 0, 10, 10], [30, 0, 40, 10]], np.float32)
    >>> nearest(np.array([24, 4, 26, 6], np.float32), near, 8.0)
    (1, 5.0)
    """
    if not len(others):
        return -1, np.inf
    centre = centres(box)
    gap = np.maximum(np.maximum(others[:, :2] - centre, centre - others[:, 2:]), 0)
    away = np.hypot(gap[:, 0], gap[:, 1])
    first = int(away.argmin())
    return (first, float(away[first])) if away[first] <= reach_px else (-1, np.inf)
