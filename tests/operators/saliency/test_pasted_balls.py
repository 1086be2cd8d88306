"""A pasted ball keeps its light when it is smeared, and lies at a body when it is held."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.saliency.crops import crop
from operators.saliency.pasted_balls import at_hands, half_covered, paste_balls, smeared
from operators.saliency.pasting import Bank, Cutout
from pipeline.boxes import centres
from tests.operators.saliency.lawn import BALL, still

SEEDS = st.integers(0, 2**32 - 1)


@given(st.floats(0, 30), st.floats(0, 2 * np.pi))
@settings(max_examples=40, deadline=None)
def test_a_moving_object_is_as_much_light_over_a_longer_way(length: float, angle: float) -> None:
    disc = np.zeros((9, 9), np.float32)
    disc[2:7, 2:7] = 1
    ball = Cutout(picture=np.full((9, 9, 3), 240, np.uint8), alpha=disc)

    way = np.array([np.cos(angle), np.sin(angle)], np.float32)
    found = smeared(ball, np.float32(length) * way)

    assert found.alpha.sum() == pytest.approx(disc.sum(), rel=1e-3)
    assert (found.picture[found.alpha > 0.05] >= 239).all()
    rows, columns = np.nonzero(found.alpha > 1e-3)
    wide, tall = np.ptp(columns) + 1, np.ptp(rows) + 1
    assert wide == pytest.approx(5 + abs(length * np.cos(angle)), abs=2)
    assert tall == pytest.approx(5 + abs(length * np.sin(angle)), abs=2)


@given(SEEDS)
def test_a_held_ball_is_at_somebodys_body_and_half_of_it_is_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    person = np.array([100, 50, 120, 110], np.float32)
    disc = np.pad(np.ones((7, 7), np.float32), 1)
    ball = Cutout(picture=np.full((9, 9, 3), 240, np.uint8), alpha=disc)

    x, y = at_hands(person, rng)
    found = half_covered(ball, rng)

    assert 97 <= x <= 123
    assert 62 <= y <= 92
    assert 0.35 * disc.sum() < found.alpha.sum() <= disc.sum()


def test_what_is_near_shows_more_balls_and_some_are_held(bank: Bank) -> None:
    target = crop(still(90.0), np.random.default_rng(5))
    people = target.boxes[target.labels != BALL]

    found = {
        near: [paste_balls(target, bank, np.random.default_rng(k), near=near) for k in range(80)]
        for near in (False, True)
    }

    pasted = {
        near: np.concatenate([e.boxes[len(target.labels) :] for e in examples])
        for near, examples in found.items()
    }
    assert len(pasted[True]) > 1.5 * len(pasted[False])
    assert {int(e.labels[-1]) for e in found[True]} == {BALL}
    x, y = centres(pasted[True]).T[..., None]
    left, top, right, bottom = people.T
    at_body = (x > left - 4) & (x < right + 4) & (y > top) & (y < top + 0.75 * (bottom - top))
    assert 0.2 < at_body.any(1).mean() < 0.7
