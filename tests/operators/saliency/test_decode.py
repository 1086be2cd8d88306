"""Decoding and suppression, with outputs of any content."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from operators.saliency.decode import (
    Candidates,
    class_count,
    decode_end2end,
    decode_yolo,
    decode_yolox,
    kind_of,
    suppress,
    yolox_grid,
)
from pipeline import MessageError, WeightsError
from pipeline.boxes import iou

SHARES = st.floats(0, 1, width=32)


def candidates(boxes: np.ndarray, classes: np.ndarray, angle: float = 0.0) -> Candidates:
    """Return candidates in order of falling score."""
    n = len(boxes)
    return Candidates(
        boxes=boxes.astype(np.float32),
        angles=np.full(n, angle, np.float32),
        scores=np.linspace(0.9, 0.5, n).astype(np.float32),
        classes=classes.astype(np.intp),
    )


@given(arrays(np.float32, (3, 40), elements=SHARES), SHARES)
def test_only_scores_above_the_threshold_remain_best_first(
    scores: np.ndarray, threshold: float
) -> None:
    output = np.concatenate([np.ones((4, 40), np.float32), scores])

    found = decode_yolo(output, np.full(3, max(threshold, 1e-3), np.float32))

    assert len(found.scores) == (scores.max(0) >= max(threshold, np.float32(1e-3))).sum()
    assert np.all(np.diff(found.scores) <= 0)


def test_a_class_above_its_own_threshold_wins_over_a_better_one_below() -> None:
    output = np.array([[10, 10, 4, 4, 0.6, 0.4]], np.float32).T.repeat(8, 1)

    found = decode_yolo(output, np.array([0.7, 0.3], np.float32))

    assert set(found.classes) == {1}


def test_yolox_offsets_are_cells_and_sizes_logarithms() -> None:
    grid = yolox_grid(64, 64)
    output = np.zeros((len(grid.cells), 6), np.float32)
    # the tenth cell of stride 8 is the third of the second row
    output[10] = [0.5, 0.25, np.log(2), np.log(4), 0.8, 0.5]

    found = decode_yolox(output, np.array([0.3], np.float32), grid)

    assert found.boxes == pytest.approx(np.array([[12, -6, 28, 26]]))
    assert found.scores == pytest.approx([0.4])


@given(arrays(np.float32, (84, 7), elements=st.floats(-50, 50, width=32)))
def test_a_wild_yolox_output_overflows_nothing(output: np.ndarray) -> None:
    found = decode_yolox(output, np.array([0.5, 0.5], np.float32), yolox_grid(64, 64))

    assert np.isfinite(found.boxes).all()


@pytest.mark.parametrize(
    ("shape", "size_px", "task", "kind", "classes"),
    [
        ((1, 84, 8400), (640, 640), "", "yolo", 80),
        ((1, 84, 8400), (640, 640), "detect", "yolo", 80),
        ((1, 20, 21504), (1024, 1024), "obb", "obb", 15),
        ((1, 5, 8400), (640, 640), "", "yolo", 1),
        ((1, 3549, 85), (416, 416), "", "yolox", 80),
        ((1, 84, 85), (64, 64), "", "yolox", 80),
        ((1, 84, 85), (64, 64), "detect", "yolo", 80),
        ((1, 3549, 6), (416, 416), "", "yolox", 1),
        ((1, 300, 6), (640, 640), "detect", "end2end", 0),
        ((1, 0, 6), (640, 640), "", "end2end", 0),
        ((1, 300, 7), (640, 640), "obb", "end2end", 0),
    ],
)
def test_the_kind_is_told_by_the_shape(
    shape: tuple[int, ...], size_px: tuple[int, int], task: str, kind: str, classes: int
) -> None:
    found = kind_of(shape, size_px, task)

    assert (found, class_count(shape, found)) == (kind, classes)


@pytest.mark.parametrize(
    "shape", [(1, 25200, 85), (8400, 84), (2, 84, 8400), (1, 4, 8400), (1, 300, 5), (300, 6), ()]
)
def test_a_shape_of_no_kind_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(WeightsError, match=r"for a 640x640 input, got \("):
        kind_of(shape, (640, 640))


@given(arrays(np.float32, (30, 6), elements=st.floats(0, 1, width=32)), SHARES)
def test_suppressed_rows_above_the_threshold_remain_best_first(
    output: np.ndarray, threshold: float
) -> None:
    output[:, 5] = np.arange(30) % 3

    found = decode_end2end(output, np.array([threshold, threshold, 2], np.float32))

    wanted = (output[:, 4] > 0) & (output[:, 4] >= np.float32(threshold)) & (output[:, 5] < 2)
    assert len(found.scores) == wanted.sum()
    assert np.all(np.diff(found.scores) <= 0)


@pytest.mark.parametrize("label", [-1, 2, 0.5, np.nan, np.inf])
def test_a_class_that_has_no_name_is_refused(label: float) -> None:
    output = np.array([[0, 0, 9, 9, 0.5, label]], np.float32)

    with pytest.raises(MessageError, match=r"expected classes 0 to 1, as many as .* names, got"):
        decode_end2end(output, np.array([0.2, 0.2], np.float32))


@given(
    arrays(np.float32, (12, 2, 2), elements=st.floats(0, 100, width=32)),
    arrays(np.int64, 12, elements=st.integers(0, 1)),
    st.floats(0.1, 0.9),
)
def test_survivors_of_one_class_never_overlap_more_than_the_limit(
    corners: np.ndarray, classes: np.ndarray, limit: float
) -> None:
    boxes = np.concatenate([corners.min(1), corners.max(1)], 1)
    given_ones = candidates(boxes, classes)

    kept = suppress(given_ones, limit, agnostic=False)

    overlap = iou(given_ones.boxes[kept], given_ones.boxes[kept])
    same = classes[kept][:, None] == classes[kept][None]
    assert kept[0] == 0
    assert not (np.triu(overlap, 1)[same] > limit).any()


def test_turned_boxes_are_compared_at_their_angles() -> None:
    # side by side along their own direction: the upright boxes would not meet at all
    boxes = np.array([[0, 40, 100, 60], [30, 10, 130, 30]], np.float32)
    upright = candidates(boxes, np.zeros(2))
    turned = candidates(boxes, np.zeros(2), angle=-np.pi / 4)

    assert suppress(upright, 0.1, agnostic=True).tolist() == [0, 1]
    assert suppress(turned, 0.1, agnostic=True).tolist() == [0]
