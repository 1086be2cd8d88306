"""Assignment of detections to tracks."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from operators.association.matching import assign, match, near

NOT_SMALL = np.zeros(2, np.float32)


def boxes(*rows: tuple[float, float, float, float]) -> np.ndarray:
    return np.array(rows, np.float32).reshape(-1, 4)


def test_the_same_class_is_matched_first_even_with_less_overlap():
    track = boxes((0, 0, 10, 10))
    found = boxes((0, 0, 10, 10), (4, 0, 14, 10))

    pairs = match(
        track, found, np.array([[False, True]]), iou_gate=0.1, reach_px=np.zeros(1, np.float32)
    )

    assert pairs.tolist() == [[0, 1]]


def test_the_remaining_detections_are_matched_across_classes():
    tracks = boxes((0, 0, 10, 10), (50, 0, 60, 10))
    found = boxes((51, 0, 61, 10))

    pairs = match(tracks, found, np.zeros((2, 1), bool), iou_gate=0.1, reach_px=NOT_SMALL)

    assert pairs.tolist() == [[1, 0]]


@pytest.mark.parametrize("same", [True, False])
def test_of_two_that_overlap_the_more_alike_is_matched(same):
    tracks, found = boxes((0, 0, 10, 10)), boxes((1, 0, 11, 10), (4, 0, 14, 10))

    pairs = match(
        tracks, found, np.full((1, 2), same), iou_gate=0.1, reach_px=NOT_SMALL[:1],
        likeness=lambda _, seen: np.where(seen == 1, 1.0, 0.1).astype(np.float32),
    )  # fmt: skip

    assert pairs.tolist() == [[0, 1]]


@pytest.mark.parametrize("same", [True, False])
def test_no_likeness_forbids_a_match(same):
    tracks, found = boxes((0, 0, 10, 10)), boxes((8, 0, 18, 10))

    pairs = match(
        tracks, found, np.full((1, 1), same), iou_gate=0.1, reach_px=NOT_SMALL[:1],
        likeness=lambda track, _: np.full(len(track), 1e-20, np.float32),
    )  # fmt: skip

    assert pairs.tolist() == [[0, 0]]


def test_overlap_below_the_gate_is_no_match():
    tracks, found = boxes((0, 0, 10, 10), (90, 90, 99, 99)), boxes((9, 0, 19, 10))

    pairs = match(tracks, found, np.ones((2, 1), bool), iou_gate=0.1, reach_px=NOT_SMALL)

    assert len(pairs) == 0


def test_a_small_object_that_left_its_box_is_found_by_nearness():
    tracks, found = boxes((0, 0, 16, 16)), boxes((18, 0, 34, 16))

    pairs = match(
        tracks, found, np.ones((1, 1), bool), iou_gate=0.1, reach_px=np.array([20], np.float32)
    )

    assert pairs.tolist() == [[0, 0]]


def test_nearness_needs_the_same_class_and_a_similar_size():
    tracks, reach = boxes((0, 0, 16, 16)), np.array([100], np.float32)

    person = match(
        tracks, boxes((20, 0, 60, 90)), np.ones((1, 1), bool), iou_gate=0.1, reach_px=reach
    )
    boot = match(
        tracks, boxes((20, 0, 36, 16)), np.zeros((1, 1), bool), iou_gate=0.1, reach_px=reach
    )

    assert len(person) == 0
    assert len(boot) == 0


def test_nearness_is_one_at_the_centre_and_zero_at_the_reach():
    value = near(
        boxes((0, 0, 10, 10)),
        boxes((0, 0, 10, 10), (5, 0, 15, 10), (20, 0, 30, 10)),
        np.array([10], np.float32),
    )

    np.testing.assert_allclose(value, [[1, 0.5, 0]], atol=1e-6)


@pytest.mark.parametrize("side", [8.0, 100.0])
@pytest.mark.parametrize(("times", "alike"), [(0.49, 0), (0.5, 1), (2.0, 1), (2.01, 0)])
def test_nearness_is_zero_for_more_than_twice_or_less_than_half_the_size(side, times, alike):
    tracks, middle, half = boxes((0, 0, side, side)), side / 2, side * times / 2
    found = boxes((middle - half, 0, middle + half, side))

    value = near(tracks, found, np.array([100], np.float32))

    assert value == pytest.approx(alike, abs=1e-6)


def test_boxes_without_area_may_be_near_and_inverted_boxes_never_are():
    points, turned = boxes((5, 5, 5, 5)), boxes((6, 6, 4, 4))
    reach = np.array([10], np.float32)

    assert near(points, points, reach) == 1
    assert near(turned, turned, reach) == 0


def test_the_greatest_total_overlap_wins_not_the_greedy_choice():
    value = np.array([[0.9, 0.8], [0.7, 0.0]], np.float32)

    assert assign(value, value > 0).tolist() == [[0, 1], [1, 0]]


box = st.tuples(*[st.floats(-50, 2000, width=32) for _ in range(4)])


@given(st.lists(box, max_size=6), st.lists(box, max_size=6), st.integers(0, 2**32 - 1))
@example([(0.0, 1e-6, 0.0, 0.0)], [(0.0, 0.0, 0.0, 0.0)], 0)
def test_every_track_and_every_detection_is_paired_at_most_once(a, b, seed):
    tracks, found = boxes(*a), boxes(*b)
    same = np.random.default_rng(seed).random((len(a), len(b))) < 0.5

    pairs = match(tracks, found, same, iou_gate=0.1, reach_px=np.full(len(a), 30, np.float32))

    assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)
    assert (np.diff(pairs[:, 0]) > 0).all()
