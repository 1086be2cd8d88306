"""Colours of parts of boxes are medians, in CIELAB."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.boxes import parts_of
from pipeline.colours import BRIGHTNESS, SHORTS, TORSO, colours, differences

places, sides = st.floats(-40, 60, width=32), st.floats(1, 30, width=32)
WHOLE = (0.0, 0.0, 1.0, 1.0)


@given(
    seed=st.integers(0, 2**16), left=sides, top=sides, width=st.floats(1, 30), high=st.floats(1, 30)
)
def test_each_part_has_the_median_of_its_pixels(
    seed: int, left: float, top: float, width: float, high: float
) -> None:
    picture = np.random.default_rng(seed).integers(0, 256, (40, 50, 3), np.uint8)
    box = np.array([[left, top, left + width, top + high]], np.float32)

    found = colours(picture, box)

    for part, where in enumerate((TORSO, SHORTS)):
        x0, y0, x1, y1 = parts_of(box, where)[0]
        patch = picture[
            max(0, int(y0)) : max(0, int(np.ceil(y1))), max(0, int(x0)) : max(0, int(np.ceil(x1)))
        ]
        if not patch.size:
            assert np.isnan(found[0, part]).all()
            continue
        lab = cv2.cvtColor(np.ascontiguousarray(patch), cv2.COLOR_RGB2LAB).reshape(-1, 3)
        assert found[0, part].tolist() == np.median(lab, 0).tolist()


def test_a_shirt_and_shorts_are_told_apart() -> None:
    picture = np.zeros((40, 20, 3), np.uint8)
    picture[:20], picture[20:] = (220, 30, 30), (240, 240, 240)

    (found,) = colours(picture, np.array([[0, 0, 20, 40]], np.float32))

    assert found[0, 1] > 160  # towards red
    assert found[1].tolist() == pytest.approx([241, 128, 128], abs=3)


@pytest.mark.filterwarnings("error")
@given(arrays(np.float32, (3, 4), elements=st.floats(width=32), fill=st.nothing()))
def test_boxes_of_any_numbers_have_colours_or_none(boxes: np.ndarray) -> None:
    picture = np.full((20, 10, 3), 128, np.uint8)
    limit = np.float32(1e30)  # far beyond it the sides of a box overflow
    boxes = np.where(np.abs(boxes) < limit, boxes, np.float32(np.nan))

    found = colours(picture, boxes)

    assert (np.isnan(found) | np.isin(found, (128, 137))).all()


def test_of_no_boxes_there_are_no_colours() -> None:
    picture = np.zeros((4, 4, 3), np.uint8)

    assert colours(picture, np.zeros((0, 4), np.float32)).shape == (0, 2, 3)
    assert colours(picture, np.zeros((2, 4), np.float32), [WHOLE]).shape == (2, 1, 3)


def test_brightness_counts_less_than_colour() -> None:
    dark, bright, red = (
        np.array([[[50.0, 128, 128]]]),
        np.array([[[90.0, 128, 128]]]),
        np.array([[[50.0, 168, 128]]]),
    )

    assert differences(dark, bright)[0, 0] == pytest.approx(BRIGHTNESS * 40)
    assert differences(dark, red)[0, 0] == pytest.approx(40)
    assert differences(np.zeros((2, 1, 3, 3)), np.zeros((5, 3, 3))).shape == (2, 5, 3)
