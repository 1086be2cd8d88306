"""Marks lie on shirts and beside feet; what is round is too small for a ball."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.saliency.augment import BALL_TO_PERSON
from operators.saliency.marks import BADGE, LEAST_TALL_PX, SCRAP, with_marks
from tests.operators.saliency.lawn import still

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS, st.floats(20, 120))
@settings(deadline=None, max_examples=40)
def test_marks_leave_sky_legs_and_the_example_alone(seed: int, tall_px: float) -> None:
    example = still(tall_px, (480, 270))
    before = example.picture.copy()

    after = with_marks(example, np.random.default_rng(seed))

    assert np.array_equal(example.picture, before)
    changed = np.flatnonzero((after != before).any((1, 2)))
    people = example.boxes[example.labels == 0]
    tall = float(np.median(people[:, 3] - people[:, 1]))
    if len(changed):
        assert changed[0] > people[:, 1].min() - 2
        assert changed[-1] < people[:, 3].max() + 0.6 * tall + 2


def test_what_is_round_is_smaller_than_a_ball() -> None:
    assert max(BADGE[1], SCRAP[1]) < BALL_TO_PERSON[0]


def test_shirts_get_numbers_and_badges_in_every_second_case() -> None:
    example = still(100.0, (480, 270))
    chests = [
        (int(left), int(top + 0.2 * (bottom - top)), int(right), int(top + 0.42 * (bottom - top)))
        for left, top, right, bottom in example.boxes[example.labels == 0].tolist()
    ]

    marked = [
        bool((after != example.picture)[low:high, left:right].any())
        for seed in range(60)
        for after in [with_marks(example, np.random.default_rng(seed))]
        for left, low, right, high in chests
    ]

    assert 0.4 < np.mean(marked) < 0.75


def test_people_too_small_for_a_mark_and_empty_pictures_stay_as_they_are() -> None:
    example = still(54.0, (480, 270))
    none = np.zeros(len(example.labels), np.bool_)
    empty = replace(
        example, boxes=example.boxes[none], labels=example.labels[none], ignored=none[none]
    )
    small = replace(example, boxes=example.boxes[:1] * 0 + [9, 9, 12, 9 + LEAST_TALL_PX / 2])
    small = replace(small, labels=example.labels[:1], ignored=example.ignored[:1])

    assert np.array_equal(with_marks(empty, np.random.default_rng(1)), empty.picture)
    after = with_marks(small, np.random.default_rng(2))
    assert np.array_equal(after[9:12], small.picture[9:12])
