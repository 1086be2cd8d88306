"""Readings of the same text become one instance."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.reader.instances import MOST_INSTANCES, MOST_VOTES, Instances
from operators.reader.ocr import Reading

Boxes = NDArray[np.float32]


def reading(text: str = "CAFE", score: float = 0.9) -> Reading:
    return Reading(text=text, score=score, box=(0, 0, 1, 1))


def boxes(*rows: tuple[float, float, float, float]) -> Boxes:
    return np.array(rows, np.float32)


def test_a_text_that_moves_steadily_keeps_its_id() -> None:
    instances = Instances(forget_after=60)

    for seq in range(10):
        left = 100.0 + 30 * seq
        instances.hear([reading()], boxes((left, 50, left + 40, 62)), seq)

    assert [each.id for each in instances.kept] == [1]


def test_a_text_that_was_not_read_for_some_frames_is_known_where_it_went() -> None:
    instances = Instances(forget_after=60)
    for seq in (0, 1):
        instances.hear([reading()], boxes((10.0 * seq, 0, 10.0 * seq + 40, 10)), seq)

    instances.hear([reading("CAFF")], boxes((80, 0, 120, 10)), 8)

    (only,) = instances.kept
    assert (only.id, only.text) == (1, "CAFE")


def test_two_texts_in_different_places_are_two() -> None:
    instances = Instances(forget_after=60)

    instances.hear([reading("A1"), reading("B2")], boxes((0, 0, 40, 10), (200, 0, 240, 10)), 0)

    assert sorted(each.text for each in instances.kept) == ["A1", "B2"]


def test_most_votes_win_however_sure_one_other_was() -> None:
    instances = Instances(forget_after=60)
    said = [reading("BANK", 0.7), reading("BAMK", 0.95), reading("BANK", 0.7)]

    for seq, each in enumerate(said):
        instances.hear([each], boxes((0, 0, 40, 10)), seq)

    (only,) = instances.kept
    assert only.text == "BANK"
    assert 0.3 < only.score < 0.7  # less than its readings, since one disagreed


def test_what_was_not_read_for_long_is_forgotten() -> None:
    instances = Instances(forget_after=5)
    instances.hear([reading()], boxes((0, 0, 40, 10)), 0)

    instances.hear([], boxes().reshape(0, 4), 6)

    assert not instances.kept


def test_what_has_left_the_field_is_not_in_view() -> None:
    instances = Instances(forget_after=60)
    for seq in (0, 1):
        instances.hear([reading()], boxes((-30.0 * seq, 0, 40 - 30.0 * seq, 10)), seq)

    assert len(instances.in_view(1, (640, 360))) == 1
    assert not instances.in_view(3, (640, 360))


numbers = st.floats(-1e4, 1e4, allow_nan=False, width=32)


@given(
    st.lists(st.lists(st.tuples(numbers, numbers, st.text(max_size=9)), max_size=20), max_size=30)
)
def test_what_is_kept_has_limits_whatever_is_read(
    frames: list[list[tuple[float, float, str]]],
) -> None:
    instances = Instances(forget_after=1000)

    for seq, found in enumerate(frames):
        places = [(x, y, x + 20, y + 8) for x, y, _ in found]
        texts = [reading(text or "?") for _, _, text in found]
        instances.hear(texts, np.array(places, np.float32).reshape(-1, 4), seq)

    assert len(instances.kept) <= MOST_INSTANCES
    assert all(len(each.votes) <= MOST_VOTES for each in instances.kept)
    assert len({each.id for each in instances.kept}) == len(instances.kept)
