"""Means with intervals: episodes of many clips -> IoU, its 95 % interval, paired differences.

Frames of one start, and starts of one clip, are not independent; therefore a whole clip is a block.
The interval is Student's t over the blocks, with the jackknife's standard error: a bootstrap of few
blocks is too narrow (simulated coverage of "95 %" with 6 blocks: .85). Below `LEAST_BLOCKS` none is
given: of fewer blocks the spread itself is hardly known. The README has the simulated coverage.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

LEAST_BLOCKS = 6
LEVEL = 0.95
SPENT = 2  # degrees of freedom; with the usual 1, means of skewed clips are covered in .92
METHOD = (
    f"{LEVEL:.0%}, Student's t over clips with the jackknife's error; from {LEAST_BLOCKS} clips"
)


@dataclass(frozen=True, kw_only=True)
class Block:
    """The share of one block: the sum of IoU over its frames, their number, and that of starts."""

    total: float
    frames: int
    starts: int


@dataclass(frozen=True, kw_only=True)
class Mean:
    """A mean over all frames of all blocks, and its 95 % interval; NaN where it has none."""

    iou: float
    low: float
    high: float
    frames: int
    starts: int


def mean(blocks: Mapping[str, Block]) -> Mean:
    """Return the mean over blocks and its interval; NaN where no frame counts."""
    totals, frames = _columns(blocks, sorted(blocks))
    middle = _ratio(totals, frames)
    arm = _arm(_left_out(totals, frames))
    return Mean(
        iou=middle,
        low=middle - arm,
        high=middle + arm,
        frames=int(frames.sum()),
        starts=sum(b.starts for b in blocks.values()),
    )


def difference(a: Mapping[str, Block], b: Mapping[str, Block]) -> tuple[float, float, float]:
    """Return mean of a minus mean of b over the blocks of both, and its interval; paired."""
    names = sorted(a.keys() & b.keys())
    first, second = _columns(a, names), _columns(b, names)
    middle = _ratio(*first) - _ratio(*second)
    arm = _arm(_left_out(*first) - _left_out(*second))
    return middle, middle - arm, middle + arm


def _arm(left_out: NDArray[np.float64]) -> float:
    """Return half the interval's length from the figures without one block each: (n,)."""
    count = len(left_out)
    if count < LEAST_BLOCKS:
        return float("nan")
    error = np.sqrt((count - 1) / count * ((left_out - left_out.mean()) ** 2).sum())
    return float(t.ppf((1 + LEVEL) / 2, count - SPENT) * error)


def _left_out(totals: NDArray[np.float64], frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean over all blocks but one, for each of them: (n,)."""
    rest = frames.sum() - frames
    means = (totals.sum() - totals) / np.maximum(rest, 1)
    return np.asarray(np.where(rest > 0, means, np.nan), np.float64)


def _ratio(totals: NDArray[np.float64], frames: NDArray[np.float64]) -> float:
    return float(totals.sum() / frames.sum()) if frames.sum() else float("nan")


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
