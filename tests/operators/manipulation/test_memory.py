"""What the ROI showed stays in the picture until the context over it changes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators.manipulation.memory import SharpMemory

SIDE = 24
LEFT, RIGHT = np.zeros((SIDE, SIDE), bool), np.zeros((SIDE, SIDE), bool)
LEFT[:, : SIDE // 2] = True
RIGHT[:, SIDE // 2 :] = True


def grey(level: int) -> np.ndarray:
    return np.full((SIDE, SIDE, 3), level, np.uint8)


def test_what_the_roi_showed_is_kept_while_the_context_stays() -> None:
    subject = SharpMemory(6)
    subject.add(grey(100), grey(10), LEFT)

    picture = subject.add(grey(103), grey(20), RIGHT)

    assert (picture[LEFT] == 10).all()
    assert (picture[RIGHT] == 20).all()


def test_where_the_context_changed_the_context_is_shown() -> None:
    subject = SharpMemory(6)
    subject.add(grey(100), grey(10), LEFT)
    moved = grey(100)
    moved[:12, :12] = 140

    picture = subject.add(moved, moved, np.zeros_like(LEFT))

    assert (picture[:9, :9] == 140).all()
    assert (picture[15:, :12] == 10).all()


def test_a_slow_change_ends_it_too() -> None:
    subject = SharpMemory(6)
    subject.add(grey(100), grey(10), LEFT)

    for level in range(101, 110):
        picture = subject.add(grey(level), grey(level), np.zeros_like(LEFT))

    assert (picture[:, :9] == 109).all()


@given(st.lists(st.tuples(st.integers(0, 255), st.booleans()), min_size=1, max_size=6))
def test_without_a_limit_of_change_nothing_is_kept(frames: list[tuple[int, bool]]) -> None:
    subject = SharpMemory(0)
    for level, left in frames:
        seen = LEFT if left else RIGHT
        picture = subject.add(grey(level), grey(7), seen)

        assert (picture[seen] == 7).all()
        assert (picture[~seen] == level).all()


def test_a_successor_shows_the_same_and_a_picture_of_another_size_begins_anew() -> None:
    subject, successor = SharpMemory(6), SharpMemory(6)
    subject.add(grey(100), grey(10), LEFT)

    successor.restore(subject.state())
    same = successor.add(grey(100), grey(100), np.zeros_like(LEFT))
    smaller = successor.add(grey(50)[:8], grey(50)[:8], np.zeros((8, SIDE), bool))

    assert (same[LEFT] == 10).all()
    assert (smaller == 50).all()
