"""The consumer's picture: every frame lands where it belongs, the ROI on top of the context."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.manipulation.picture import place, shown
from pipeline import Frame, Geometry, Header

FIELD = 64, 48
WHOLE = 0.0, 0.0, 1.0, 1.0


def frame(pixels: NDArray[np.uint8], window: tuple[int, int, int, int]) -> Frame:
    geometry = Geometry(width_px=FIELD[0], height_px=FIELD[1])
    header = Header(stream="s", seq=0, stamp_ns=0, geometry=geometry)
    return Frame(header=header, pixels=pixels, window=window)


def field(seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 255, (FIELD[1], FIELD[0], 3), np.uint8)


def test_a_picture_of_the_field_at_its_size_is_the_frame_itself() -> None:
    pixels = field(1)

    np.testing.assert_array_equal(shown([frame(pixels, (0, 0, *FIELD))], WHOLE, FIELD), pixels)


@given(st.integers(0, 48), st.integers(0, 36), st.integers(1, 16), st.integers(1, 12))
def test_a_window_at_full_resolution_lies_over_the_context_and_touches_nothing_else(
    left: int, top: int, width: int, height: int
) -> None:
    pixels, context = field(2), np.full((12, 16, 3), 7, np.uint8)
    roi = pixels[top : top + height, left : left + width]
    window = (left, top, left + width, top + height)

    found = shown([frame(context, (0, 0, *FIELD)), frame(roi, window)], WHOLE, FIELD)

    np.testing.assert_array_equal(found[top : top + height, left : left + width], roi)
    found[top : top + height, left : left + width] = 7
    assert (found == 7).all()


def test_a_part_of_the_field_is_cut_out_and_averaged() -> None:
    pixels = field(3)
    out = np.zeros((12, 16, 3), np.uint8)

    place(pixels, (0, 0, *FIELD), FIELD, out, (0.25, 0.25, 0.75, 0.75))

    cells = pixels[12:36, 16:48].reshape(12, 2, 16, 2, 3).mean((1, 3))
    assert np.abs(out - cells).max() <= 1


def test_frames_without_pixels_and_windows_outside_change_nothing() -> None:
    empty = frame(np.zeros((0, 0, 3), np.uint8), (0, 0, 0, 0))
    outside = frame(np.full((4, 4, 3), 9, np.uint8), (0, 0, 4, 4))

    found = shown([empty, outside], (0.5, 0.5, 1, 1), (16, 12))

    assert not found.any()
