"""Training pictures as a raw sensor shows them."""

import numpy as np
import pytest

from operators.saliency.augment import augment
from operators.saliency.example import Example
from operators.saliency.sensor_noise import through_sensor


def flat(value: tuple[int, int, int]) -> np.ndarray:
    return np.full((120, 160, 3), value, np.uint8)


def example() -> Example:
    return Example(
        picture=np.random.default_rng(1).integers(0, 256, (120, 160, 3), np.uint8),
        boxes=np.array([[40, 40, 60, 90]], np.float32),
        labels=np.zeros(1, np.int64),
        ignored=np.zeros(1, np.bool_),
    )


@pytest.mark.parametrize("seed", range(8))
def test_colours_stay_and_noise_comes(seed):
    colour = (150, 90, 60)

    seen = through_sensor(flat(colour), np.random.default_rng(seed)).reshape(-1, 3)

    assert seen.mean(0) == pytest.approx(colour, abs=3)
    assert (seen.std(0) > 0.3).all()
    assert np.array_equal(
        seen, through_sensor(flat(colour), np.random.default_rng(seed)).reshape(-1, 3)
    )


def test_light_varies_from_picture_to_picture():
    spreads = [
        through_sensor(flat((120, 120, 120)), np.random.default_rng(seed)).std()
        for seed in range(30)
    ]

    assert max(spreads) > 5 * min(spreads)


def test_without_a_share_a_training_picture_is_what_it_was():
    plain = augment(example(), np.random.default_rng(5))
    never = augment(example(), np.random.default_rng(5), 0.0)
    always = augment(example(), np.random.default_rng(5), 1.0)

    assert np.array_equal(plain.picture, never.picture)
    assert not np.array_equal(plain.picture, always.picture)
    assert np.array_equal(plain.boxes, always.boxes)
