"""A drawn corner has a pole and lines; every second one a ball, at the pole's foot or on a line."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.saliency.augment import BALL_TO_PERSON, MOST_BALL_PX
from operators.saliency.corners import CORNER_SHARE, with_corner
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
        most = min(1.15 * tall_px * BALL_TO_PERSON[1], MOST_BALL_PX)
        assert 1.8 - 1e-3 <= right - left <= most + 1e-3
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
    at_pole = on_line = 0

    balls = [after for after in corners(example) if len(after.labels) > len(example.labels)]
    for after in balls:
        left, top, right, bottom = after.boxes[-1]
        x, y, reach = int((left + right) / 2), int((top + bottom) / 2), int(right - left) + 3
        changed = (after.picture != example.picture).any(2)
        above = changed[max(0, int(y - 0.7 * TALL_PX)) : int(top), max(0, x - 8) : x + 8]
        low, high = max(0, y - 2 * reach), y + 2 * reach
        beside = changed[low:high, x + reach : x + reach + 4].any(0).all()
        other = changed[low:high, max(0, x - reach - 4) : max(0, x - reach)].any(0).all()
        at_pole += bool(len(above) and above.any(1).mean() > 0.8)
        on_line += bool(beside and other)

    assert 0.6 * len(balls) < at_pole < 0.95 * len(balls)
    assert on_line > 0.8 * len(balls)


def test_poles_stand_where_people_do_and_where_the_grass_ends() -> None:
    example = still(TALL_PX, (480, 270))
    example.picture[:60] = (40, 40, 60)  # boards

    feet = float(example.boxes[example.labels != BALL, 3].max())
    drawn = [after for after in corners(example) if after is not example]
    lowest = [np.flatnonzero((a.picture != example.picture).any((1, 2))).max() for a in drawn]

    far = sum(row < feet - TALL_PX for row in lowest) / len(drawn)
    near = sum(row > feet - 0.4 * TALL_PX for row in lowest) / len(drawn)
    assert far > 0.15
    assert near > 0.25


def test_where_nothing_is_grass_a_pole_stands_where_people_do() -> None:
    example = still(TALL_PX, (480, 270))
    example.picture[:] = (40, 40, 60)
    feet = float(example.boxes[example.labels != BALL, 3].max())

    for after in corners(example):
        if after is example:
            continue
        changed = (after.picture != example.picture).any(2)
        # a pole is at least .6 of a person's height, so that no pole stands at the lower border
        columns = changed[int(feet + 2) : int(feet + 2 + 0.5 * TALL_PX)].all(0)
        assert not columns.any()


def test_a_picture_without_people_stays_as_it_is() -> None:
    example = still(TALL_PX, (480, 270))
    ball = example.labels == BALL
    alone = Example(
        picture=example.picture, boxes=example.boxes[ball], labels=example.labels[ball],
        ignored=example.ignored[ball],
    )  # fmt: skip

    assert all(after is alone for after in corners(alone))
