"""Memory of ROI features per object: RoiFeatures in, features over To frames out.

It also keeps a verdict per object: the encoder's mean confidence that the object is of its labelled
class. An object that was refuted need not be looked at again.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import RoiFeatures
from pipeline.errors import MessageError

CAPACITY = 100  # verdicts: four per object reported at once, as objects come and go
LOOKS = 2  # views before a verdict counts
WEIGHT = 0.5  # of the latest view in a verdict
Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """ROI features of the last frames, and verdicts on at most `capacity` objects, oldest first."""

    capacity: int
    seqs: NDArray[np.int64]  # (m,) frame of each look
    ids: NDArray[np.int32]  # (m,)
    features: Array  # (m, D)
    judged: NDArray[np.int32]  # (k,) ids
    genuine: Array  # (k,) running mean, 0..1
    looks: NDArray[np.int32]  # (k,)


def blank(capacity: int = CAPACITY) -> Memory:
    """Return an empty memory."""
    return Memory(
        capacity=capacity,
        seqs=np.zeros(0, np.int64),
        ids=np.zeros(0, np.int32),
        features=np.zeros((0, 0), np.float32),
        judged=np.zeros(0, np.int32),
        genuine=np.zeros(0, np.float32),
        looks=np.zeros(0, np.int32),
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
    verdicts = _judge(memory, seen)
    return Memory(
        capacity=memory.capacity,
        seqs=np.concatenate([memory.seqs[recent], np.full(len(seen.ids), seq, np.int64)]),
        ids=np.concatenate([memory.ids[recent], seen.ids]),
        features=np.concatenate([known, seen.features]),
        judged=verdicts[0],
        genuine=verdicts[1],
        looks=verdicts[2],
    )


def fault(seen: RoiFeatures) -> str:
    """Return a sentence when features contain non-finite numbers, else an empty string."""
    if np.isfinite(seen.features).all() and np.isfinite(seen.genuine).all():
        return ""
    return f"policy.features: expected finite numbers in frame {seen.header.seq}, got others"


def _judge(memory: Memory, seen: RoiFeatures) -> tuple[NDArray[np.int32], Array, NDArray[np.int32]]:
    """Return the updated verdicts; the object viewed longest ago is dropped first."""
    now, then = np.nonzero(seen.ids[:, None] == memory.judged)
    before, genuine = np.zeros(len(seen.ids), np.int32), seen.genuine.copy()
    before[now] = memory.looks[then]
    genuine[now] += (1 - WEIGHT) * (memory.genuine[then] - genuine[now])
    others = np.ones(len(memory.judged), np.bool_)
    others[then] = False
    newest = slice(-memory.capacity, None)
    return (
        np.concatenate([memory.judged[others], seen.ids])[newest],
        np.concatenate([memory.genuine[others], genuine])[newest].astype(np.float32),
        np.concatenate([memory.looks[others], before + 1])[newest].astype(np.int32),
    )


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


def refuted(memory: Memory, ids: NDArray[np.int32], least: float) -> NDArray[np.bool_]:
    """Return which objects were viewed and refuted: (n,)."""
    false = memory.judged[(memory.looks >= LOOKS) & (memory.genuine < least)]
    return np.isin(ids, false)
