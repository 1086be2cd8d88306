"""Coverage of the ground truth by the ROI: boxes and windows in, shares per label out."""

import numpy as np
from numpy.typing import NDArray

from drivers.source import Annotations
from pipeline.boxes import centres, covered_by


class Coverage:
    """Sums, per label, the share of the true box that lay inside the ROI.

    Several objects of one label in a frame are averaged first, so every frame weighs the same.
    """

    def __init__(self) -> None:
        self._sums: dict[str, float] = {}
        self._frames: dict[str, int] = {}

    def add(self, truth: Annotations, *windows: tuple[int, int, int, int]) -> None:
        """Account for one exposure: what several windows show of a box counts once."""
        shares = covered_by(truth.boxes, np.array(windows, np.float32))
        labels = np.array(truth.labels)
        for label in set(truth.labels):
            mean = float(shares[labels == label].mean())
            self._sums[label] = self._sums.get(label, 0.0) + mean
            self._frames[label] = self._frames.get(label, 0) + 1

    def shares(self) -> dict[str, float]:
        """Mean share per label over the frames where it is present, and `mean` over labels."""
        found = {label: self._sums[label] / self._frames[label] for label in sorted(self._sums)}
        if found:
            found["mean"] = sum(found.values()) / len(found)
        return found

    def frames(self) -> dict[str, int]:
        """Frames in which each label was present."""
        return {label: self._frames[label] for label in sorted(self._frames)}


def where(truth: Annotations, label: str) -> NDArray[np.float32] | None:
    """Centre (x, y) of the most visible object of a label, None when there is none."""
    found = [i for i, name in enumerate(truth.labels) if name == label]
    if not found:
        return None
    best = max(found, key=lambda i: float(truth.visibility[i]))
    return np.asarray(centres(truth.boxes[best]), np.float32)
