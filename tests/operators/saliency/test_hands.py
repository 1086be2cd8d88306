"""Hands are drawn around a ball, cover a part of it, and leave the rest of the picture alone."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.saliency.hands import hands_over

SEEDS = st.integers(0, 2**32 - 1)
SIDE_PX = 160


def covering(seed: int, diameter_px: float, place: tuple[float, float]) -> NDArray[np.float64]:
    """How much of each pixel hands and arms cover: what black and white pictures do not keep."""
    black = np.zeros((SIDE_PX, SIDE_PX, 3), np.uint8)
    dark = hands_over(black, place, diameter_px, np.random.default_rng(seed))
    light = hands_over(black + 255, place, diameter_px, np.random.default_rng(seed))
    assert not black.any()
    return np.asarray(1 - (light.astype(float) - dark)[..., 0] / 255)


@given(SEEDS, st.floats(4, 24), st.tuples(st.floats(0, SIDE_PX), st.floats(0, SIDE_PX)))
@settings(deadline=None, max_examples=60)
def test_hands_change_only_what_is_near(
    seed: int, diameter_px: float, place: tuple[float, float]
) -> None:
    covered = covering(seed, diameter_px, place)

    y, x = np.mgrid[:SIDE_PX, :SIDE_PX]
    far = np.maximum(abs(x - place[0]), abs(y - place[1])) > 2.5 * diameter_px + 4
    assert (covered[far] < 0.01).all()


def test_a_part_of_the_ball_stays_in_view() -> None:
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX]
    ball = np.hypot(x - 80, y - 80) < 8

    shares = [covering(seed, 16.0, (80.5, 80.5))[ball].mean() for seed in range(300)]

    assert 0.15 < np.median(shares) < 0.5
    assert np.mean(np.array(shares) > 0.9) < 0.02
    assert np.mean(np.array(shares) < 0.02) < 0.1
