"""What a detector finds in the ROI, and how sure it was of that over several frames.

A ball in gloves is seldom the surest find of one frame. But it is found again and again near one
place, while false finds come and go: tracked before it is detected, it is told from them.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from pipeline import Detections
from pipeline.boxes import centres, sizes
from pipeline.messages import Boxes, Ids, Scores

GAIN = 0.3  # of the latest frame in a rating
GONE = 6  # frames in succession without it after which a find is forgotten
LATE = 2  # frames between a picture and the finds that may speak of it
MOST = 64  # the surest of a frame; no more are remembered
NEAR = 0.75  # maximum distance of centres of one object, in sizes of the larger box
LEAST = 0.3  # rating from which a find counts
ALIKE = 2.0  # if their sizes differ by less than this factor
FAR_PX = 2.0**20  # beyond any field: no box, and nothing to calculate with


@dataclass(frozen=True, kw_only=True, eq=False)
class Finds:
    """What was found lately; n may be 0."""

    boxes: Boxes = field(default_factory=lambda: np.zeros((0, 4), np.float32))
    labels: Ids = field(default_factory=lambda: np.zeros(0, np.int32))
    # the mean of its scores, 0 in a frame without it; older frames count less
    ratings: Scores = field(default_factory=lambda: np.zeros(0, np.float32))
    missed: Ids = field(default_factory=lambda: np.zeros(0, np.int32))  # frames
    names: tuple[str, ...] = ()
    seq: int = -1  # the last frame in which the detector looked

    def best(self, name: str, size_px: float) -> int:
        """Return the row of the best of a class and size in this frame, -1 for none.

        One that is rated below `LEAST` is none.
        """
        fit = (self.missed == 0) & (self.ratings >= LEAST) & of_class(self, name)
        fit &= alike(sizes(self.boxes), np.float32(size_px))
        return int(np.where(fit, self.ratings, -1).argmax()) if fit.any() else -1

    def speak_of(self, seq: int) -> bool:
        """Whether they are of this frame, or of one next to it: they come as they are ready."""
        return self.seq >= 0 and abs(seq - self.seq) <= LATE

    def name_at(self, box: NDArray[np.float32]) -> str:
        """Return the class of what was found at a box (4,) in this frame; empty: nothing was."""
        there = (self.missed == 0) & same(box[None], self.boxes)[0]
        rows = np.flatnonzero(there)
        if not len(rows):
            return ""
        apart = np.linalg.norm(centres(self.boxes[rows]) - centres(box), axis=1)
        label = int(self.labels[rows[apart.argmin()]])
        return self.names[label] if 0 <= label < len(self.names) else ""


def after(before: Finds, seen: Detections) -> Finds:
    """Return the finds after a frame in which a detector looked.

    Those of a detector with other classes, and after `GONE` frames without a look, are forgotten.
    """
    fit = np.flatnonzero((np.abs(seen.boxes) < FAR_PX).all(1) & np.isfinite(seen.scores))
    rows = fit[np.argsort(-seen.scores[fit], kind="stable")[:MOST]]
    boxes, labels, scores = seen.boxes[rows], seen.labels[rows], np.clip(seen.scores[rows], 0, 1)
    goes_on = 0 < seen.header.seq - before.seq <= GONE and before.names == seen.names
    known = before if goes_on else Finds()
    old, new = matched(known, boxes, labels)
    left = np.ones(len(known.boxes), np.bool_)
    left[old] = False
    left &= known.missed + 1 < GONE
    ratings = GAIN * scores
    ratings[new] += (1 - GAIN) * known.ratings[old]
    missed = np.concatenate([np.zeros(len(rows), np.int32), known.missed[left] + 1])
    ratings = np.concatenate([ratings, (1 - GAIN) * known.ratings[left]])
    best = np.argsort(-ratings, kind="stable")[:MOST]
    return Finds(
        boxes=np.concatenate([boxes, known.boxes[left]])[best],
        labels=np.concatenate([labels, known.labels[left]])[best],
        ratings=ratings[best].astype(np.float32),
        missed=missed[best].astype(np.int32),
        names=seen.names,
        seq=seen.header.seq,
    )


def matched(
    known: Finds, boxes: Boxes, labels: NDArray[np.int32]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows of finds and rows of boxes (n, 4) that are the same object: (k,), (k,)."""
    apart = distances(known.boxes, boxes)
    fit = same(known.boxes, boxes) & (known.labels[:, None] == labels)
    far = 1 + 2 * float(apart.max(initial=0)) * (1 + min(apart.shape))
    old, new = linear_sum_assignment(np.where(fit, apart, far))
    kept = fit[old, new]
    return old[kept], new[kept]


def same(a: Boxes, b: Boxes) -> NDArray[np.bool_]:
    """Whether boxes are of one object, as far as place and size tell: (n, 4), (m, 4) -> (n, m).

    Overlap would not do: a ball of 15 pixels is foreseen some pixels beside itself.

    >>> ball = np.array([[100, 100, 116, 116]], np.float32)
    >>> [same(ball, other).item() for other in (ball + 8, ball + 20, ball * [1, 1, 2, 2])]
    [True, False, False]
    """
    larger = np.maximum(sizes(a)[:, None], sizes(b)[None])
    near = distances(a, b) <= NEAR * larger
    return np.asarray(near & alike(sizes(a)[:, None], sizes(b)[None]))


def alike(a: NDArray[np.float32], b: NDArray[np.float32] | np.float32) -> NDArray[np.bool_]:
    """Whether two sizes may be of one object."""
    return np.asarray(np.maximum(a, b) <= ALIKE * np.minimum(a, b))


def distances(a: Boxes, b: Boxes) -> NDArray[np.float32]:
    """Distance of the centres of every pair: (n, 4), (m, 4) -> (n, m), pixels."""
    return np.asarray(np.linalg.norm(centres(a)[:, None] - centres(b)[None], axis=2), np.float32)


def of_class(finds: Finds, name: str) -> NDArray[np.bool_]:
    """Return which finds are of a class: (n,)."""
    own = [label for label, known in enumerate(finds.names) if known == name]
    return np.asarray(np.isin(finds.labels, own))
