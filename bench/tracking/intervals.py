"""Means with intervals: episodes of many clips -> IoU, 95 % by block bootstrap, paired differences.

Frames of one start, and starts of one clip, are not independent; therefore whole clips are drawn,
each of them a block. One clip has a mean and no interval.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DRAWS = 2000


@dataclass(frozen=True, kw_only=True)
class Block:
    """The share of one block: the sum of IoU over its frames, their number, and that of starts."""

    total: float
    frames: int
    starts: int


@dataclass(frozen=True, kw_only=True)
class Mean:
    """A mean over all frames of all blocks, and the range of 95 % of the redrawn means."""

    iou: float
    low: float
    high: float
    frames: int
    starts: int


def mean(blocks: Mapping[str, Block], *, seed: int) -> Mean:
    """Return the mean over blocks and its interval; NaN where no frame counts."""
    names = sorted(blocks)
    totals, frames = _columns(blocks, names)
    drawn = ratios(totals, frames, draws(len(names), seed))
    return Mean(
        iou=float(totals.sum() / frames.sum()) if frames.sum() else float("nan"),
        low=_quantile(drawn, 2.5),
        high=_quantile(drawn, 97.5),
        frames=int(frames.sum()),
        starts=sum(b.starts for b in blocks.values()),
    )


def difference(
    a: Mapping[str, Block], b: Mapping[str, Block], *, seed: int
) -> tuple[float, float, float]:
    """Return mean of a minus mean of b over the blocks of both, and its interval; paired."""
    names = sorted(a.keys() & b.keys())
    first, second = _columns(a, names), _columns(b, names)
    rows = draws(len(names), seed)
    apart = ratios(*first, rows) - ratios(*second, rows)
    whole = np.arange(len(names))[None]
    middle = (ratios(*first, whole) - ratios(*second, whole))[0] if names else np.nan
    return float(middle), _quantile(apart, 2.5), _quantile(apart, 97.5)


def draws(count: int, seed: int) -> NDArray[np.int64]:
    """Return blocks drawn with replacement: (DRAWS, count)."""
    rng = np.random.default_rng([seed, count])
    return np.asarray(rng.integers(0, max(count, 1), (DRAWS, count)), np.int64)


def ratios(
    totals: NDArray[np.float64], frames: NDArray[np.float64], rows: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the mean of each draw; NaN where it has no frame."""
    counted = frames[rows].sum(1)
    return np.asarray(
        np.where(counted > 0, totals[rows].sum(1) / np.maximum(counted, 1), np.nan), np.float64
    )


def add(blocks: dict[str, Block], name: str, values: Sequence[float]) -> None:
    """Add a start to a block, unless no frame counts."""
    if values:
        old = blocks.get(name, Block(total=0.0, frames=0, starts=0))
        blocks[name] = Block(
            total=old.total + sum(values),
            frames=old.frames + len(values),
            starts=old.starts + 1,
        )


def _columns(
    blocks: Mapping[str, Block], names: Sequence[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    totals = np.array([blocks[name].total for name in names], np.float64)
    frames = np.array([blocks[name].frames for name in names], np.float64)
    return totals, frames


def _quantile(values: NDArray[np.float64], share: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, share)) if len(known) else float("nan")
