"""What a detector finds in the ROI again and again is told from what comes and goes."""

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.tracker.finds import GONE, LEAST, MOST, Finds, after
from pipeline import Detections
from pipeline.codec import dumps, loads
from pipeline.testing import header

NAMES = ("player", "ball")
BALL = np.array([100, 100, 116, 116], np.float32)
BADGE = np.array([300, 100, 316, 116], np.float32)
SIZE_PX = 16.0
SEQS = itertools.count()


def seen(
    *found: tuple[Sequence[float] | NDArray[np.float32], float], label: int = 1,
    names: tuple[str, ...] = NAMES, seq: int = -1,
) -> Detections:  # fmt: skip
    """Return what a detector found: boxes with their scores; each time in the next frame."""
    count = len(found)
    return Detections(
        header=header(next(SEQS) if seq < 0 else seq),
        boxes=np.array([box for box, _ in found], np.float32).reshape(count, 4),
        angles=np.zeros(count, np.float32), scores=np.array([s for _, s in found], np.float32),
        labels=np.full(count, label, np.int32), features=np.zeros((count, 0), np.float32),
        names=names,
    )  # fmt: skip


def best(finds: Finds) -> list[float]:
    row = finds.best("ball", SIZE_PX)
    return finds.boxes[row].tolist() if row >= 0 else []


def test_what_is_found_again_and_again_is_above_what_is_surer_for_a_frame() -> None:
    finds = Finds()
    for k in range(8):
        finds = after(finds, seen((BALL + k, 0.5)))  # it moves by a pixel in a frame

    finds = after(finds, seen((BALL + 8, 0.5), (BADGE, 0.9)))

    assert best(finds) == (BALL + 8).tolist()


def test_one_find_is_none_until_it_has_been_there_for_some_frames() -> None:
    finds = after(Finds(), seen((BALL, 0.9)))
    assert best(finds) == []

    assert best(after(finds, seen((BALL, 0.9)))) == BALL.tolist()


def test_a_rating_falls_in_a_frame_without_the_find_and_it_is_no_answer_there() -> None:
    finds = Finds()
    for _ in range(30):
        finds = after(finds, seen((BALL, 0.8)))
    assert finds.ratings[0] == pytest.approx(0.8, abs=0.01)

    finds = after(finds, seen())

    assert finds.ratings[0] == pytest.approx(0.56, abs=0.01)
    assert best(finds) == []
    assert best(after(finds, seen((BALL, 0.8)))) == BALL.tolist()


def test_a_find_that_is_missing_for_some_frames_is_forgotten() -> None:
    finds = after(Finds(), seen((BALL, 0.8)))

    for missing in range(1, GONE + 1):
        finds = after(finds, seen())
        assert len(finds.boxes) == (missing < GONE)


@pytest.mark.parametrize(
    ("name", "size_px", "label"), [("player", SIZE_PX, 1), ("ball", 50.0, 1), ("ball", SIZE_PX, 0)]
)
def test_another_class_and_another_size_are_no_answer(
    name: str, size_px: float, label: int
) -> None:
    finds = Finds()
    for _ in range(9):
        finds = after(finds, seen((BALL, 0.9), label=label))

    assert finds.best(name, size_px) == -1


def test_classes_of_another_detector_begin_anew() -> None:
    finds = after(Finds(), seen((BALL, 0.9)))

    finds = after(finds, seen((BALL, 0.9), names=("ball", "player")))

    assert finds.ratings.tolist() == pytest.approx([0.27])


@pytest.mark.parametrize(("gap", "known"), [(1, True), (GONE, True), (GONE + 1, False), (0, False)])
def test_finds_of_long_ago_or_of_a_stream_that_began_anew_are_forgotten(
    gap: int, known: bool
) -> None:
    finds = after(Finds(), seen((BALL, 0.9), seq=40))

    assert len(after(finds, seen(seq=40 + gap)).boxes) == known
    assert not len(after(finds, seen(seq=3)).boxes)


def test_finds_speak_of_their_frame_and_of_those_next_to_it() -> None:
    finds = after(Finds(), seen((BALL, 0.9), seq=40))

    assert [finds.speak_of(seq) for seq in (37, 38, 40, 42, 43)] == [False, True, True, True, False]
    assert not Finds().speak_of(0)


def test_what_is_at_a_box_is_called_by_the_nearest_find_of_this_frame() -> None:
    near, players = seen((BALL + 3, 0.3), (BALL + 30, 0.9)), seen((BALL, 0.9), label=0)
    assert after(Finds(), near).name_at(BALL) == "ball"
    assert after(Finds(), near).name_at(BADGE) == ""
    assert after(after(Finds(), players), seen((BALL + 3, 0.3))).name_at(BALL) == "ball"
    assert after(after(Finds(), players), seen()).name_at(BALL) == ""
    assert after(Finds(), seen((BALL, 0.9), label=7)).name_at(BALL) == ""  # of no known class


def test_a_successor_goes_on_with_the_finds() -> None:
    before = after(after(Finds(), seen((BALL, 0.9), (BADGE, 0.2))), seen((BALL, 0.9)))

    known = loads(Finds, dumps(before))

    assert best(after(known, seen((BALL, 0.9)))) == BALL.tolist()
    assert known.missed.tolist() == [0, 1]


anything = st.floats(width=32)


@given(
    st.lists(
        st.lists(
            st.tuples(st.lists(anything, min_size=4, max_size=4), anything, st.integers(-2, 3)),
            max_size=90,
        ),
        max_size=4,
    )
)
def test_whatever_a_detector_sends_the_finds_stay_few_finite_and_rated_within_0_to_1(
    frames: list[list[tuple[list[float], float, int]]],
) -> None:
    finds = Finds()
    for frame in frames:
        message = seen(*((box, score) for box, score, _ in frame))
        labels = np.array([label for *_, label in frame], np.int32)
        finds = after(finds, seen() if not frame else altered_labels(message, labels))

    assert len(finds.boxes) <= MOST
    assert np.isfinite(finds.boxes).all()
    assert ((finds.ratings >= 0) & (finds.ratings <= 1)).all()
    row = finds.best("ball", SIZE_PX)
    assert row == -1 or finds.ratings[row] >= LEAST


def altered_labels(message: Detections, labels: NDArray[np.int32]) -> Detections:
    return Detections(**{**vars(message), "labels": labels})
