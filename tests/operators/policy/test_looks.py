"""What was shown and read: known by track and by place, bounded, and robust to any reading."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.policy.looks import CAPACITY, KEPT, Looks, carried, exposed, no_looks, noted
from operators.policy.readability import chances
from pipeline.errors import MessageError
from tests.operators.policy.made_up_texts import reading, tracks

SIGN = (1, 400.0, 300.0, 20.0)
numbers = st.floats(width=32, allow_nan=True, allow_infinity=True)


def read_of(looks: Looks, track_id: int) -> float:
    return float(looks.read[looks.ids == track_id][0])


def test_a_reading_belongs_to_the_track_that_it_covers() -> None:
    world = tracks(0, SIGN, (2, 900.0, 300.0, 20.0))
    looks = carried(no_looks(), world)

    looks = noted(looks, reading(0, world.boxes[:1, -1] + 3, 0.9))

    assert (read_of(looks, 1), read_of(looks, 2)) == (pytest.approx(0.9), 0)


def test_a_line_that_was_read_covers_all_its_words() -> None:
    looks = carried(no_looks(), tracks(0, SIGN, (2, 500.0, 300.0, 20.0)))

    looks = noted(looks, reading(0, np.array([[350, 290, 550, 310]]), 0.9))

    assert looks.read.tolist() == pytest.approx([0.9, 0.9])


def test_a_word_that_was_read_is_not_the_whole_line() -> None:
    looks = carried(no_looks(), tracks(0, SIGN))

    looks = noted(looks, reading(0, np.array([[360, 290, 380, 310]]), 0.9))

    assert looks.read.tolist() == [0]


def test_a_late_reading_finds_a_text_that_has_moved_on() -> None:
    before, now = tracks(0, SIGN, speed_px=30), tracks(4, (1, 520.0, 300.0, 20.0), speed_px=30)
    looks = carried(carried(no_looks(), before), now)

    looks = noted(looks, reading(0, before.boxes[:, -1], 0.9))

    assert read_of(looks, 1) == pytest.approx(0.9)


def test_a_text_that_loses_its_track_stays_read_under_the_next_one() -> None:
    looks = carried(no_looks(), tracks(0, SIGN, speed_px=5))
    looks = noted(looks, reading(0, tracks(0, SIGN).boxes[:, -1], 0.9))
    for seq in range(1, 10):
        looks = carried(looks, tracks(seq))

    looks = carried(looks, tracks(10, (7, 450.0, 300.0, 20.0), speed_px=5))

    assert looks.ids.tolist() == [7]
    assert read_of(looks, 7) == pytest.approx(0.9)


def test_a_text_elsewhere_is_another_one() -> None:
    looks = carried(no_looks(), tracks(0, SIGN))
    looks = noted(looks, reading(0, tracks(0, SIGN).boxes[:, -1], 0.9))

    looks = carried(looks, tracks(1, (7, 900.0, 300.0, 20.0)))

    assert read_of(looks, 7) == 0


def test_a_text_without_a_track_is_forgotten_in_the_end() -> None:
    looks = carried(no_looks(), tracks(0, SIGN))

    for seq in range(1, KEPT + 2):
        looks = carried(looks, tracks(seq))

    assert not len(looks.ids)


def test_only_texts_that_a_window_shows_whole_count_as_shown() -> None:
    looks = carried(no_looks(), tracks(0, SIGN, (2, 900.0, 300.0, 9.0)))

    looks = exposed(looks, np.array([300, 200, 890, 400], np.float32), 0)

    assert looks.shown.tolist() == [1, 0]
    assert looks.tried[0] == chances(np.array([20], np.float32))[0]
    assert looks.shown_seq.tolist() == [0, -1]


def test_texts_that_do_not_fit_the_boxes_are_refused() -> None:
    looks = carried(no_looks(), tracks(0, SIGN))
    wrong = reading(0, np.zeros((1, 4)), 0.9)
    object.__setattr__(wrong, "texts", ("a", "b"))

    with pytest.raises(MessageError, match="expected one for each box, got 2 for 1 boxes"):
        noted(looks, wrong)


@settings(max_examples=50, deadline=None)
@given(
    boxes=st.lists(st.tuples(numbers, numbers, numbers, numbers), max_size=5),
    score=numbers,
    text=st.text(max_size=3),
)
def test_whatever_a_reader_reports_scores_stay_between_none_and_one(
    boxes: list[tuple[float, float, float, float]], score: float, text: str
) -> None:
    looks = carried(no_looks(), tracks(0, SIGN))
    told = reading(0, np.array(boxes, np.float32).reshape(-1, 4), *[score] * len(boxes), text=text)

    with np.errstate(all="ignore"):
        looks = noted(looks, told)

    assert 0 <= read_of(looks, 1) <= 1


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 8))
def test_the_table_is_bounded_and_has_each_track_once(seed: int, frames: int) -> None:
    rng, looks = np.random.default_rng(seed), no_looks()

    for seq in range(frames):
        ids = rng.choice(1000, size=int(rng.integers(0, 60)), replace=False)
        world = tracks(seq, *((int(i), *rng.uniform(0, 700, 2), 10.0) for i in ids))
        looks = carried(looks, world)
        assert looks.ids[: len(ids)].tolist() == ids.tolist()

    assert len(looks.ids) <= CAPACITY
    assert len(set(looks.ids.tolist())) == len(looks.ids)
