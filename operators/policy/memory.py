"""Memory of ROI features per object: RoiFeatures in, features over To frames out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import RoiFeatures
from pipeline.errors import MessageError

Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """ROI features of the last frames."""

    seqs: NDArray[np.int64]  # (m,) frame of each look
    ids: NDArray[np.int32]  # (m,)
    features: Array  # (m, D)


def blank() -> Memory:
    """Return an empty memory."""
    return Memory(
        seqs=np.zeros(0, np.int64),
        ids=np.zeros(0, np.int32),
        features=np.zeros((0, 0), np.float32),
    )


def remember(memory: Memory, seen: RoiFeatures, observed: int) -> Memory:
    """Return the memory after one more ROI; it keeps the features of `observed` frames.

    Raises `MessageError` when the features change their width.
    """
    seq, width = seen.header.seq, seen.features.shape[1]
    if len(memory.ids) and len(seen.ids) and memory.features.shape[1] != width:
        known = memory.features.shape[1]
        raise MessageError(f"policy.features: expected {known} channels, got {width}")
    recent = memory.seqs > seq - observed
    known = memory.features[recent] if recent.any() else np.zeros((0, width), np.float32)
    return Memory(
        seqs=np.concatenate([memory.seqs[recent], np.full(len(seen.ids), seq, np.int64)]),
        ids=np.concatenate([memory.ids[recent], seen.ids]),
        features=np.concatenate([known, seen.features]),
    )


def fault(seen: RoiFeatures) -> str:
    """Return a sentence when features contain non-finite numbers, else an empty string."""
    if np.isfinite(seen.features).all() and np.isfinite(seen.genuine).all():
        return ""
    return f"policy.features: expected finite numbers in frame {seen.header.seq}, got others"


def recall(
    memory: Memory, ids: NDArray[np.int32], *, seq: int, observed: int, channels: int
) -> Array:
    """Return features of objects in frames seq-To+1 … seq: (n,) -> (n, To, D); 0 where missing.

    Raises `MessageError` when the features are not `channels` wide.
    """
    found = np.zeros((len(ids), observed, channels), np.float32)
    if not len(memory.ids):
        return found
    if memory.features.shape[1] != channels:
        raise MessageError(
            f"policy.features: expected {channels} channels, got {memory.features.shape[1]}"
        )
    column = memory.seqs - seq + observed - 1
    row, look = np.nonzero(ids[:, None] == memory.ids)
    known = (column[look] >= 0) & (column[look] < observed)
    row, look = row[known], look[known]
    found[row, column[look]] = memory.features[look]
    return found
