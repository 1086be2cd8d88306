"""The loop by stage as a stack: what each stage took -> a picture."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.visualise.stack import COLOURS, COLUMNS, DARK, ROWS, StageStack, scale_of


def heights(shades: np.ndarray, column: int) -> list[int]:
    """Rows of each colour in a column, from below."""
    found = [tuple(shade) for shade in shades[::-1, column]]
    return [found.count(colour) for colour in dict.fromkeys(found)]


def test_areas_are_as_high_as_what_their_stages_took():
    stack = StageStack()

    stack.add({"capture": 10.0, "saliency": 30.0, "dispatch": 35.0})

    shown = stack.picture()
    assert shown is not None
    assert shown.full_ms == 50
    assert heights(shown.shades, COLUMNS - 1) == pytest.approx(
        [ROWS * ms / 50 for ms in (10, 20, 5, 15)], abs=1
    )
    assert (shown.shades[-1, -1] == COLOURS[0]).all()
    assert (shown.shades[0] == DARK).all()
    assert (shown.shades[:, :-1] == DARK).all()  # there were no frames before
    assert shown.names == ("capture 10", "saliency 20", "dispatch 5.0")


def test_nothing_is_drawn_before_the_first_frame():
    stack = StageStack()

    stack.add({})

    assert stack.picture() is None


def test_frames_of_another_graph_are_left_dark():
    stack = StageStack()
    stack.add({"capture": 10.0})

    stack.add({"capture": 10.0, "added": 20.0})

    shown = stack.picture()
    assert shown is not None
    assert (shown.shades[:, -2] == DARK).all()
    assert len(heights(shown.shades, COLUMNS - 1)) == 2


def test_one_slow_frame_does_not_make_the_others_flat():
    stack = StageStack()
    for age_ms in (*[20.0] * 60, 4000.0):
        stack.add({"capture": age_ms})

    shown = stack.picture()

    assert shown is not None
    assert shown.full_ms == 20
    assert (shown.shades[:, -1] == COLOURS[0]).all()


TIMES = st.lists(st.floats(-1e3, 1e6, allow_nan=False), min_size=1, max_size=14)


@given(st.lists(TIMES, min_size=1, max_size=COLUMNS + 3))
def test_any_times_have_a_picture_of_the_same_size(frames: list[list[float]]):
    stack = StageStack()
    for times in frames:
        stack.add({f"stage {k}": ms for k, ms in enumerate(times)})

    shown = stack.picture()

    assert shown is not None
    assert shown.shades.shape == (ROWS, COLUMNS, 3)
    assert len(shown.names) == len(shown.colours) == len(frames[-1])


@given(st.floats(0, 1e7))
def test_the_scale_has_room_and_not_more_than_two_and_a_half_times_of_it(most_ms: float):
    assert max(1, most_ms) <= scale_of(most_ms) <= max(1, 2.5 * most_ms)
