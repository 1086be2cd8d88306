"""Temporal ensembling: chunks of targets in, the targets of the coming steps out."""

import numpy as np
from numpy.typing import NDArray


class Ensemble:
    """Averages what all chunks so far say of a step, older ones weighing more.

    The weights are exp(-`decay` i) for the i-th oldest chunk, as ACT does it.
    """

    def __init__(self, decay: float) -> None:
        self._decay = decay
        self._first = np.zeros(0, np.int64)  # step of each chunk's first row
        self._chunks: list[NDArray[np.float32]] = []

    def add(self, step: int, chunk: NDArray[np.float32]) -> None:
        """Take the targets (chunk, joints) of `step` and those after it; forget older chunks."""
        kept = [i for i, first in enumerate(self._first) if first + len(chunk) > step]
        self._chunks = [*(self._chunks[i] for i in kept), chunk]
        self._first = np.append(self._first[kept], step)

    def targets(self, step: int, count: int) -> NDArray[np.float32]:
        """Return the targets (up to `count`, joints) of `step` and those after it."""
        rows = []
        for at in range(step, step + count):
            known = [
                chunk[at - first]
                for first, chunk in zip(self._first, self._chunks, strict=True)
                if 0 <= at - first < len(chunk)
            ]
            if not known:
                break
            weights = np.exp(-self._decay * np.arange(len(known)))
            rows.append(np.average(known, axis=0, weights=weights))
        return np.array(rows, np.float32)
