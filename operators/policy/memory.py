"""What the ROI last showed of each object: RoiFeatures in, the newest vector per id out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import RoiFeatures
from pipeline.errors import MessageError


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """The newest features of at most `capacity` objects; the longest unseen is forgotten first."""

    capacity: int
    ids: NDArray[np.int32]  # (n,), oldest first
    seqs: NDArray[np.int64]  # (n,), the frame they were seen in
    features: NDArray[np.float32]  # (n, D)


def blank(capacity: int) -> Memory:
    """Nothing remembered."""
    return Memory(
        capacity=capacity,
        ids=np.zeros(0, np.int32),
        seqs=np.zeros(0, np.int64),
        features=np.zeros((0, 0), np.float32),
    )


def remember(memory: Memory, seen: RoiFeatures) -> Memory:
    """The memory after one more ROI; raises `MessageError` when the features change their width."""
    if not len(seen.ids):
        return memory
    width, known = seen.features.shape[1], memory.features
    if len(memory.ids) and known.shape[1] != width:
        raise MessageError(f"policy.features: expected {known.shape[1]} channels, got {width}")
    keep = ~np.isin(memory.ids, seen.ids)
    seqs = np.full(len(seen.ids), seen.header.seq, np.int64)
    newest = slice(-memory.capacity, None)
    return Memory(
        capacity=memory.capacity,
        ids=np.concatenate([memory.ids[keep], seen.ids])[newest],
        seqs=np.concatenate([memory.seqs[keep], seqs])[newest],
        features=np.concatenate([known.reshape(-1, width)[keep], seen.features])[newest],
    )


def recall(memory: Memory, ids: NDArray[np.int32], width: int) -> NDArray[np.float32]:
    """Features of these objects: (n,) -> (n, width); 0 for what was never seen."""
    found = np.zeros((len(ids), width), np.float32)
    if len(memory.ids):
        order = np.argsort(memory.ids)
        place = np.minimum(np.searchsorted(memory.ids, ids, sorter=order), len(order) - 1)
        known = memory.ids[order[place]] == ids
        found[known] = memory.features[order[place[known]]]
    return found
