"""Temporal ensembling: chunks of targets in, the targets of the coming steps out."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from pipeline import Shape

MOST_CHUNKS = 1000  # that count at once


@dataclass(frozen=True, kw_only=True)
class EnsembleState:
    """The chunks that still count, oldest first, for a successor."""

    first: Annotated[NDArray[np.int64], Shape.of("n")]  # step of each chunk's first row
    chunks: Annotated[NDArray[np.float32], Shape.of("n", "chunk", "joints")]


class Ensemble:
    """Averages what all chunks so far say of a step, older ones weighing more.

    The weights are exp(-`decay` i) for the i-th oldest chunk, as in ACT (Zhao et al., 2023).
    """

    def __init__(self, decay: float) -> None:
        self._decay = decay
        self._first: list[int] = []  # step of each chunk's first row
        self._chunks: list[NDArray[np.float32]] = []

    def add(self, step: int, chunk: NDArray[np.float32]) -> None:
        """Take the targets (chunk, joints) of `step` and those after it; forget what is past."""
        known = [
            (first, told)
            for first, told in zip(self._first, self._chunks, strict=True)
            if first + len(told) > step and told.shape == chunk.shape
        ][-MOST_CHUNKS + 1 :]
        self._first = [*(first for first, _ in known), step]
        self._chunks = [*(told for _, told in known), chunk]

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

    def state(self) -> EnsembleState:
        """Return the chunks that still count."""
        chunks = np.stack(self._chunks) if self._chunks else np.zeros((0, 0, 0), np.float32)
        return EnsembleState(first=np.array(self._first, np.int64), chunks=chunks)

    def restore(self, state: EnsembleState) -> None:
        """Take over the chunks of another."""
        self._first, self._chunks = state.first.tolist(), [*state.chunks]
