"""Context, ROI, Scanpath -> Percept: starting, following, losing and handing over."""

import numpy as np
import pytest

from operators.tracker import Tracker, TrackerSettings
from pipeline import Percept, SettingsError, WeightsError
from pipeline.boxes import iou
from pipeline.codec import dumps, loads
from pipeline.testing import drive, header
from tests.operators.tracker.made_up import World

WORLD = World(seed=11)
START = {"method": "correlation", "init_box": tuple(WORLD.box(0).tolist())}


def overlap(percept: Percept) -> float:
    return float(iou(percept.boxes, WORLD.box(percept.header.seq)[None])[0, 0])


@pytest.mark.parametrize("roi", [True, False])
def test_an_object_is_followed_through_the_roi_and_through_the_context_alone(roi):
    percepts = drive(Tracker, [WORLD.frames(k, roi=roi) for k in range(40)], START)

    assert min(overlap(p) for p in percepts) > (0.8 if roi else 0.6)
    assert percepts[-1].boxes.shape == (1, 4)


def test_an_object_is_followed_while_the_roi_comes_and_goes():
    percepts = drive(Tracker, [WORLD.frames(k, roi=k % 3 != 0) for k in range(40)], START)

    assert min(overlap(p) for p in percepts) > 0.6


def test_without_anything_to_follow_the_answer_is_empty():
    (percept,) = drive(Tracker, [WORLD.frames(0)], {"method": "correlation"})

    assert percept.boxes.shape == (0, 4)
    assert len(percept.ids) == len(percept.scores) == 0


def test_following_starts_where_the_scanpath_foresees_its_object():
    messages = [WORLD.frames(0), WORLD.scanpath(0, object_id=6), WORLD.frames(1), WORLD.frames(2)]

    percepts = [p for p in drive(Tracker, messages, {"method": "correlation"}) if p]

    assert percepts[1].ids.tolist() == [6]
    assert overlap(percepts[1]) == 1
    assert overlap(percepts[2]) > 0.8


def test_a_place_is_nothing_to_start_on():
    messages = [WORLD.scanpath(0, object_id=-1), WORLD.frames(1)]

    percepts = drive(Tracker, messages, {"method": "correlation"})

    assert len(percepts[-1].boxes) == 0


def test_a_scanpath_that_has_run_out_starts_nothing():
    messages = [WORLD.scanpath(0, object_id=6), WORLD.frames(5)]

    percepts = drive(Tracker, messages, {"method": "correlation"})

    assert len(percepts[-1].boxes) == 0


def test_a_lost_object_keeps_its_place_then_the_scanpath_says_where_to_start_again():
    messages = [WORLD.frames(k) for k in range(5)]
    messages += [WORLD.frames(k, hidden=True) for k in range(5, 8)]
    messages += [WORLD.scanpath(7, object_id=9), WORLD.frames(8, hidden=True), WORLD.frames(9)]

    values = {**START, "lost_after": 4, "lost_score": 0.8}
    percepts = [p for p in drive(Tracker, messages, values) if p]

    assert [int(p.ids[0]) for p in percepts] == [-1] * 8 + [9, 9]
    assert percepts[5].boxes.tolist() == percepts[7].boxes.tolist()
    assert percepts[7].scores[0] < 0.8


def test_a_successor_with_the_state_follows_the_same_object():
    old, successor = (Tracker(TrackerSettings(**START)) for _ in range(2))
    for subject in (old, successor):
        subject.open()
        subject.on_stream(header(0))
    for k in range(10):
        old.on_context_roi(**WORLD.frames(k))

    successor.restore(loads(type(old.state()), dumps(old.state())))

    for k in range(10, 20):
        assert overlap(successor.on_context_roi(**WORLD.frames(k))) > 0.8


def test_a_new_stream_starts_again_on_the_box_that_was_set():
    subject = Tracker(TrackerSettings(**START))
    subject.open()
    for k in range(5):
        subject.on_context_roi(**WORLD.frames(k))

    subject.on_stream(header(0, stream="other"))
    percept = subject.on_context_roi(**WORLD.frames(0))

    assert percept.boxes.tolist() == [list(START["init_box"])]


def test_weights_that_are_not_there_are_named():
    with pytest.raises(WeightsError, match=r"expected an ONNX file, got .*nowhere.onnx"):
        drive(Tracker, [], {"method": "vittrack", "weights": "nowhere.onnx"})


def test_a_start_that_is_no_box_is_refused():
    with pytest.raises(SettingsError, match="init_box: expected left, top, right, bottom"):
        TrackerSettings(init_box=(5.0, 5.0, 5.0, 9.0))


def test_same_frames_same_boxes():
    frames = [WORLD.frames(k) for k in range(6)]

    first, second = (drive(Tracker, frames, START) for _ in range(2))

    np.testing.assert_array_equal([p.boxes for p in first], [p.boxes for p in second])
