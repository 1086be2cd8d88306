"""RoIAlign on maps whose result is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from operators.saliency.roi_align import roi_align

BOXES = arrays(np.float32, (5, 2, 2), elements=st.floats(-40, 200, width=32))


@given(BOXES, st.integers(1, 5))
def test_a_flat_map_gives_its_value_everywhere(corners: NDArray[np.float32], grid: int) -> None:
    boxes = np.concatenate([corners.min(1), corners.max(1)], 1)
    flat = np.stack([np.full((9, 12), 3, np.float32), np.full((9, 12), -1, np.float32)])

    found = roi_align(flat, boxes, stride_px=8, grid=grid)

    assert found == pytest.approx(np.tile([3, -1], (5, 1)), abs=1e-4)


@given(st.floats(20, 70), st.floats(20, 50), st.floats(0, 20), st.floats(0, 20))
def test_a_ramp_gives_its_value_at_the_centre(x: float, y: float, wide: float, high: float) -> None:
    rows, columns = np.mgrid[:9, :12].astype(np.float32)
    box = np.array([[x - wide / 2, y - high / 2, x + wide / 2, y + high / 2]], np.float32)

    found = roi_align(np.stack([rows, columns]), box, stride_px=8)

    assert found == pytest.approx(np.array([[y / 8 - 0.5, x / 8 - 0.5]]), abs=1e-3)


def test_no_boxes_give_no_rows() -> None:
    found = roi_align(np.zeros((7, 4, 4), np.float32), np.zeros((0, 4), np.float32), stride_px=8)

    assert found.shape == (0, 7)
