"""A drawn corner has a pole and lines; every second one a ball, at the pole's foot or on a line."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.saliency.augment import BALL_TO_PERSON, MOST_BALL_PX
from operators.saliency.corners import CORNER_SHARE, REACH, with_corner
from operators.saliency.example import Example
from tests.operators.saliency.lawn import BALL, still

SEEDS = st.integers(0, 2**32 - 1)
TALL_PX = 54.0
MANY = 400


def corners(example: Example) -> list[Example]:
    """What many seeds make of an example."""
    return [with_corner(example, np.random.default_rng(k), MOST_BALL_PX) for k in range(MANY)]


@given(SEEDS, st.floats(12, 200))
@settings(deadline=None, max_examples=60)
def test_the_example_stays_and_a_ball_lies_in_the_picture(seed: int, tall_px: float) -> None:
    example = still(tall_px, (480, 270))
    before = example.picture.copy()

    after = with_corner(example, np.random.default_rng(seed), MOST_BALL_PX)

    assert np.array_equal(example.picture, before)
    known = len(example.labels)
    assert np.array_equal(after.boxes[:known], example.boxes)
    for left, top, right, bottom in after.boxes[known:].tolist():
        assert 1.8 - 1e-3 <= right - left <= min(1.15 * tall_px * BALL_TO_PERSON[1], MOST_BALL_PX)
        assert right > 2
        assert left < 478
        assert bottom > 2
        assert top < 268


def test_half_of_the_pictures_get_a_corner_and_every_second_of_these_a_ball() -> None:
    example = still(TALL_PX, (480, 270))

    made = corners(example)

    drawn = [after for after in made if after is not example]
    balls = [after for after in drawn if len(after.labels) > len(example.labels)]
    assert all((after.labels[len(example.labels) :] == BALL).all() for after in balls)
    assert len(drawn) / MANY == pytest.approx(CORNER_SHARE, abs=0.08)
    assert len(balls) / len(drawn) == pytest.approx(0.5, abs=0.13)


def test_a_ball_lies_at_a_poles_foot_or_on_a_line() -> None:
    example = still(TALL_PX, (480, 270))
    at_pole = 0

    balls = [after for after in corners(example) if len(after.labels) > len(example.labels)]
    for after in balls:
        left, top, right, bottom = after.boxes[-1]
        x, y, wide = (left + right) / 2, (top + bottom) / 2, right - left
        changed = (after.picture != example.picture).any(2)
        around = changed[
            max(0, int(y - wide)) : int(y + 2 * wide), max(0, int(x - wide)) : int(x + 2 * wide)
        ]
        assert around.any()
        above = changed[max(0, int(y - 0.7 * TALL_PX)) : int(y), max(0, int(x) - 8) : int(x) + 8]
        at_pole += bool(above.any(1).mean() > 0.8)
        rows, columns = np.nonzero(changed)
        assert np.ptp(columns) < 2.4 * REACH[1] * TALL_PX
        assert len(rows)

    assert at_pole > 0.6 * len(balls)


def test_poles_stand_where_people_do_and_where_the_grass_ends() -> None:
    example = still(TALL_PX, (480, 270))
    example.picture[:60] = (40, 40, 60)  # boards

    lowest = [
        int(np.nonzero((after.picture != example.picture).any((1, 2)))[0].max())
        for after in corners(example)
        if after is not example
    ]

    feet = float(example.boxes[example.labels != BALL, 3].max())
    far = sum(row < feet - TALL_PX for row in lowest)
    assert 0.15 < far / len(lowest) < 0.85


def test_a_picture_without_people_stays_as_it_is() -> None:
    example = still(TALL_PX, (480, 270))
    ball = example.labels == BALL
    alone = Example(
        picture=example.picture, boxes=example.boxes[ball], labels=example.labels[ball],
        ignored=example.ignored[ball],
    )  # fmt: skip

    assert all(after is alone for after in corners(alone))
