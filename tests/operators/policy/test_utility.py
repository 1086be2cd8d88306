"""Utility: what the window around a candidate would show of the target."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.policy.utility import CENTRING, UTILITIES, gains, measured, windows
from pipeline import Geometry
from pipeline.boxes import centres, roi_window

FIELD = Geometry(width_px=1920, height_px=1080, roi_width_px=480, roi_height_px=270, step_px=4)
places = st.floats(-500, 2500, width=32)


@given(x=places, y=places, side=st.floats(1, 300, width=32))
def test_windows_are_those_that_dispatch_commands(x: float, y: float, side: float) -> None:
    box = np.array([x, y, x + side, y + side], np.float32)

    assert windows(box, FIELD).tolist() == list(roi_window(centres(box), FIELD))


def test_a_neighbour_whose_window_shows_the_target_is_worth_nearly_as_much() -> None:
    ball = np.array([[900, 500, 916, 516]], np.float32)
    itself, near, far = ball, ball + 60, ball + 600

    worth = gains(np.stack([itself, near, far]), ball, FIELD)[:, 0]

    assert worth[0] > 0.99
    assert 0.8 < worth[1] < 0.95
    assert worth[2] == 0


def test_a_window_that_shows_part_of_the_target_is_worth_at_most_that_part() -> None:
    ball = np.array([[900, 500, 916, 516]], np.float32)
    beside = ball + np.array([240, 0, 240, 0], np.float32)  # its window begins at the ball's middle

    assert gains(beside[None], ball, FIELD)[0, 0] == pytest.approx((1 - CENTRING) / 2, abs=0.01)


def test_the_window_centred_on_a_person_larger_than_the_roi_is_worth_most() -> None:
    person = np.array([[900, 400, 1000, 700]], np.float32)

    worth = gains(np.stack([person, person + 40]), person, FIELD)[:, 0]

    assert worth[0] > 0.98 > 0.9 > worth[1]


def test_nothing_is_gained_where_the_target_is_not_in_the_picture() -> None:
    gone = np.zeros((3, 4), np.float32)

    assert not gains(np.full((2, 3, 4), 7, np.float32), gone, FIELD).any()


def test_the_measured_utility_is_the_same_all_over_the_window_and_nothing_beyond_it():
    ball = np.array([[940, 520, 960, 540]], np.float32)
    half = FIELD.roi_width_px / 2
    away = [np.array([part * half, 0] * 2, np.float32) for part in (0, 0.5, 0.85, 1.3)]

    worth = measured(np.stack([ball + step for step in away]), ball, FIELD)[:, 0]

    assert worth[:3] == pytest.approx(1)
    assert worth[3] == 0


@pytest.mark.parametrize("name", UTILITIES)
def test_of_a_target_outside_the_picture_nothing_is_gained_by_any_utility(name: str):
    anywhere = np.array([[[940, 520, 960, 540]]], np.float32)

    assert UTILITIES[name](anywhere, np.zeros((1, 4), np.float32), FIELD)[0, 0] == 0
