"""Verdicts on objects: what the ROI showed of each, RoiFeatures in, mean confidence out.

Track before detect, verify by looking: a weak candidate is followed, and full resolution decides
whether it is what the context took it for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import RoiFeatures

CAPACITY = 400  # verdicts: four per object reported at once, as objects come and go
LOOKS = 2  # views before a verdict counts
WEIGHT = 0.5  # of the latest view in a verdict
EVEN = 0.5  # a probability that says nothing
Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdicts:
    """Verdicts on at most `capacity` objects; the one viewed longest ago comes first."""

    capacity: int
    ids: NDArray[np.int32]  # (k,)
    genuine: Array  # (k,) running mean of the encoder's probability, 0..1
    looks: NDArray[np.int32]  # (k,)

    def of(self, ids: NDArray[np.int32]) -> Array:
        """Return the verdict on each object (n,); `EVEN` without one."""
        found = np.full(len(ids), EVEN, np.float32)
        row, known = np.nonzero(ids[:, None] == self.ids)
        settled = self.looks[known] >= LOOKS
        found[row[settled]] = self.genuine[known[settled]]
        return found

    def settled(self, ids: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return which objects were viewed often enough for a verdict: (n,)."""
        return np.asarray(self.views(ids) >= LOOKS)

    def views(self, ids: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return how often the ROI showed each object: (n,)."""
        found = np.zeros(len(ids), np.int32)
        row, known = np.nonzero(ids[:, None] == self.ids)
        found[row] = self.looks[known]
        return found


def none_given(capacity: int = CAPACITY) -> Verdicts:
    """Return no verdicts."""
    return Verdicts(
        capacity=capacity,
        ids=np.zeros(0, np.int32),
        genuine=np.zeros(0, np.float32),
        looks=np.zeros(0, np.int32),
    )


def judged(before: Verdicts, seen: RoiFeatures) -> Verdicts:
    """Return the verdicts after one more ROI; the object viewed longest ago is dropped first."""
    now, then = np.nonzero(seen.ids[:, None] == before.ids)
    looks, genuine = np.zeros(len(seen.ids), np.int32), seen.genuine.copy()
    looks[now] = before.looks[then]
    genuine[now] += (1 - WEIGHT) * (before.genuine[then] - genuine[now])
    others = np.ones(len(before.ids), np.bool_)
    others[then] = False
    newest = slice(-before.capacity, None)
    return Verdicts(
        capacity=before.capacity,
        ids=np.concatenate([before.ids[others], seen.ids])[newest],
        genuine=np.concatenate([before.genuine[others], genuine])[newest].astype(np.float32),
        looks=np.concatenate([before.looks[others], looks + 1])[newest].astype(np.int32),
    )
