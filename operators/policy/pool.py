"""Training samples of a round of roll-outs: samples -> batches on the training device."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from operators.policy.model import INPUTS
from operators.policy.rollout import Sample
from operators.policy.tokens import MOST_OBJECTS, Array, Objects, batched
from operators.training.device import has_room, moved

FEATURES = ("roi", "context")  # kept in half precision


class Pool:
    """Samples of the latest round in tensors of fixed width, on the GPU if they fit.

    A batch is then an index operation without transfer.
    """

    def __init__(self, samples: Sequence[Sample], device: torch.device) -> None:
        parts = [s.candidates for s in samples]
        chunks: dict[str, list[NDArray[Any]]] = {name: [] for name in (*INPUTS, "worth")}
        for start in range(0, len(samples), 512):
            rows = slice(start, start + 512)
            given = padded(parts[rows], [s.condition for s in samples[rows]])
            worth = np.zeros(
                (len(parts[rows]), MOST_OBJECTS, samples[0].worth.shape[1]), np.float32
            )
            for row, sample in enumerate(samples[rows]):
                worth[row, : len(sample.worth)] = sample.worth
            for name, values in (given | {"worth": worth}).items():
                chunks[name].append(values.astype(np.float16) if name in FEATURES else values)
        self._device = device
        self.kept = {name: torch.from_numpy(np.concatenate(v)) for name, v in chunks.items()}
        if has_room(device, sum(values.nbytes for values in self.kept.values())):
            self.kept = {name: values.to(device) for name, values in self.kept.items()}

    def __len__(self) -> int:
        return len(self.kept["mask"])

    def batch(self, rows: NDArray[np.intp]) -> dict[str, Tensor]:
        """Return a batch on the device."""
        index = moved(torch.from_numpy(rows), self.kept["mask"].device)
        found = {
            name: moved(values.index_select(0, index), self._device)
            for name, values in self.kept.items()
        }
        return found | {name: found[name].float() for name in FEATURES}


def padded(moments: Sequence[Objects], conditions: Sequence[Array]) -> dict[str, NDArray[Any]]:
    """Like `batched`, but always `MOST_OBJECTS` wide."""
    given: dict[str, NDArray[Any]] = dict(batched(moments, conditions))
    for name, values in given.items():
        if name != "condition":
            more = MOST_OBJECTS - values.shape[1]
            given[name] = np.pad(values, [(0, 0), (0, more), *[(0, 0)] * (values.ndim - 2)])
    return given
