"""Words as corners, as turned boxes and as upright boxes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.saliency.text.quads import areas, corners, polygon_iou, turned, upright

lengths = st.floats(1, 200)
angles = st.floats(-1.5, 1.5)


@given(x=st.floats(-50, 50), length=lengths, height=st.floats(1, 50), angle=angles)
def test_a_turned_box_is_found_again_from_its_corners(
    x: float, length: float, height: float, angle: float
) -> None:
    box = np.array([[x, 20, length, height, angle]], np.float32)

    found = turned(corners(box))

    np.testing.assert_allclose(found, box, rtol=1e-3, atol=1e-3)


def test_a_word_upside_down_has_the_angle_of_one_that_is_not() -> None:
    quads = np.array([[[0, 0], [8, 1], [8, 3], [0, 2]]], np.float32)

    assert turned(quads[:, [2, 3, 0, 1]])[0, 4] == pytest.approx(turned(quads)[0, 4])


def test_a_word_seen_from_the_side_keeps_its_centre_and_its_area() -> None:
    quads = np.array([[[0, 0], [40, 10], [40, 40], [0, 20]]], np.float32)

    box = turned(quads)[0]

    assert box[:2].tolist() == [20, 17.5]
    assert box[2] * box[3] == pytest.approx(areas(quads)[0])


def test_polygons_overlap_less_than_the_upright_boxes_around_them() -> None:
    boxes = np.array([[50, 50, 80, 8, 0.7], [56, 44, 80, 8, 0.7], [300, 50, 8, 8, 0]], np.float32)
    quads = corners(boxes)

    overlap = polygon_iou(quads, quads)

    assert np.diag(overlap) == pytest.approx(1, abs=1e-3)
    assert overlap[0, 1] < 0.1
    assert overlap[0, 2] == 0
    assert upright(quads)[2].tolist() == pytest.approx([296, 46, 304, 54])
