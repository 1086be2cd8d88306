"""The place of pictures of any size in a network's input."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators.saliency.letterbox import Letterbox, place

SIDES = st.integers(1, 900)


@given(SIDES, SIDES, st.booleans())
def test_any_picture_fits_and_touches_two_borders(width: int, height: int, corner: bool) -> None:
    spot = place(width, height, 480, 288, corner)

    assert 0 <= spot.left_px <= 480 - spot.width_px
    assert 0 <= spot.top_px <= 288 - spot.height_px
    assert spot.width_px == 480 or spot.height_px == 288


def test_pixels_are_scaled_and_the_rest_is_filled() -> None:
    box = Letterbox(480, 288, scale=1 / 255, bgr=False, corner=False)
    picture = np.zeros((270, 480, 3), np.uint8)
    picture[..., 0], picture[..., 2] = 255, 51

    box.put(picture)

    assert np.allclose(box.tensor[0, :, 150, 200], [1, 0, 0.2])
    assert np.allclose(box.tensor[0, :, 8, :], 114 / 255)


def test_channels_are_reversed_for_networks_that_expect_blue_first() -> None:
    box = Letterbox(416, 416, scale=1, bgr=True, corner=True)
    picture = np.zeros((100, 100, 3), np.uint8)
    picture[..., 0] = 200

    box.put(picture)

    assert box.tensor[0, :, 0, 0].tolist() == [0, 0, 200]


def test_a_new_size_leaves_nothing_of_the_old_picture() -> None:
    box = Letterbox(64, 64, scale=1, bgr=False, corner=False)
    box.put(np.full((64, 64, 3), 255, np.uint8))
    box.put(np.full((32, 64), 9, np.uint8))

    assert set(np.unique(box.tensor)) == {9, 114}


def test_halving_a_picture_averages_it() -> None:
    box = Letterbox(32, 32, scale=1, bgr=False, corner=True)
    stripes = np.zeros((128, 128, 3), np.uint8)
    stripes[::2] = 200

    box.put(stripes)

    assert set(np.unique(box.tensor)) == {100}
