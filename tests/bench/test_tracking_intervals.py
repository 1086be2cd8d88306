"""Intervals hold their level in simulation, or there are none."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.tracking.intervals import LEAST_BLOCKS, Block, difference, mean

ROUNDS = 3000  # the standard error of a share is then .004


def blocks(values: NDArray[np.float64], frames: NDArray[np.int64]) -> dict[str, Block]:
    return {
        f"{k:03d}": Block(total=float(v * n), frames=int(n), starts=1)
        for k, (v, n) in enumerate(zip(values, frames, strict=True))
    }


def covered(rng: np.random.Generator, count: int, shape: tuple[float, float]) -> bool:
    """Whether the interval of one simulated evaluation holds the true mean of a beta's values."""
    found = mean(blocks(rng.beta(*shape, count), rng.integers(100, 300, count)))
    return found.low <= shape[0] / sum(shape) <= found.high


@pytest.mark.parametrize("count", [6, 10])
@pytest.mark.parametrize(
    ("shape", "least"),
    [((4.0, 4.0), 0.93), ((2.0, 2.0), 0.93), ((3.0, 1.5), 0.93), ((1.0, 3.0), 0.915)],
)
def test_an_interval_over_few_clips_covers_the_true_mean(
    count: int, shape: tuple[float, float], least: float
) -> None:
    rng = np.random.default_rng(7)

    share = np.mean([covered(rng, count, shape) for _ in range(ROUNDS)])

    assert share >= least


def test_a_paired_interval_over_six_clips_covers_the_true_difference() -> None:
    rng = np.random.default_rng(11)
    held = 0
    for _ in range(ROUNDS):
        base, frames = rng.beta(2, 2, 6), rng.integers(100, 300, 6)
        apart = rng.normal(0.03, 0.05, 6)
        _, low, high = difference(blocks(base + apart, frames), blocks(base, frames))
        held += low <= 0.03 <= high

    assert held / ROUNDS >= 0.93


@pytest.mark.parametrize("count", range(LEAST_BLOCKS))
def test_fewer_clips_have_no_interval(count: int) -> None:
    few = blocks(np.linspace(0.2, 0.8, count), np.full(count, 50))

    found = mean(few)

    assert math.isnan(found.low)
    assert math.isnan(found.high)
    assert math.isnan(difference(few, few)[1])
