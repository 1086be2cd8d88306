"""Context, ROI, Scanpath -> Percept: starting, following, losing an object, and handover."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from operators.tracker import CorrelationSettings, CorrelationTracker
from pipeline import Frame, Percept, SettingsError
from pipeline.boxes import iou
from pipeline.codec import dumps, loads
from pipeline.commands import carry_out
from pipeline.testing import drive, header
from tests.operators.tracker.made_up import AWAY, World

WORLD = World(seed=11)
START = {"init_box": tuple(WORLD.box(0).tolist())}


def overlap(percept: Percept) -> float:
    return float(iou(percept.boxes, WORLD.box(percept.header.seq)[None])[0, 0])


def opened(**settings: Any) -> CorrelationTracker:
    subject = CorrelationTracker(CorrelationSettings(**settings))
    subject.open()
    subject.on_stream(header(0))
    return subject


def told(subject: CorrelationTracker, command: str, **arguments: Any) -> dict[str, Any]:
    return carry_out("tracker", subject, command, arguments)


@pytest.mark.parametrize("roi", [True, False])
def test_an_object_is_followed_through_the_roi_and_through_the_context_alone(roi):
    frames = [WORLD.frames(k, roi=roi) for k in range(40)]

    percepts = drive(CorrelationTracker, frames, START)

    assert min(overlap(p) for p in percepts) > (0.8 if roi else 0.6)
    assert percepts[-1].boxes.shape == (1, 4)


def test_an_object_is_followed_while_the_roi_comes_and_goes():
    frames = [WORLD.frames(k, roi=k % 3 != 0) for k in range(40)]

    percepts = drive(CorrelationTracker, frames, START)

    assert min(overlap(p) for p in percepts) > 0.6


def test_an_object_is_followed_through_any_of_several_windows():
    def exposure(k: int) -> dict[str, Frame]:
        near, far = WORLD.frames(k), WORLD.frames(k, at=AWAY)
        return {"context": near["context"], "roi": far["roi"], "roi_3": near["roi"]}

    several = drive(CorrelationTracker, [exposure(k) for k in range(20)], START)
    single = drive(CorrelationTracker, [WORLD.frames(k) for k in range(20)], START)
    beside = drive(CorrelationTracker, [WORLD.frames(k, at=AWAY) for k in range(20)], START)

    pairs = list(zip(several, single, beside, strict=True))
    assert all(np.array_equal(a.boxes, b.boxes) for a, b, _ in pairs)
    assert any(not np.array_equal(a.boxes, c.boxes) for a, _, c in pairs)


def test_following_starts_in_the_window_that_shows_the_policys_object():
    near, far = WORLD.frames(1), WORLD.frames(1, at=AWAY)
    exposure = {"context": near["context"], "roi": far["roi"], "roi_2": near["roi"]}

    percepts = drive(CorrelationTracker, [WORLD.scanpath(0, object_id=6), exposure])

    assert percepts[-1].ids.tolist() == [6]


def test_without_anything_to_follow_the_answer_is_empty():
    (percept,) = drive(CorrelationTracker, [WORLD.frames(0)])

    assert percept.boxes.shape == (0, 4)
    assert len(percept.ids) == len(percept.scores) == 0


def test_following_starts_where_the_scanpath_predicts_its_object():
    messages = [WORLD.frames(0), WORLD.scanpath(0, object_id=6), WORLD.frames(1), WORLD.frames(2)]

    percepts = [p for p in drive(CorrelationTracker, messages) if p]

    assert percepts[1].ids.tolist() == [6]
    assert overlap(percepts[1]) == 1
    assert overlap(percepts[2]) > 0.8


def test_the_box_of_the_settings_is_followed_until_lost_and_then_the_object_of_the_policy():
    messages: list[Any] = [WORLD.frames(k) for k in range(5)]
    messages += [WORLD.frames(k, hidden=True) for k in range(5, 8)]
    messages += [WORLD.scanpath(7, object_id=9), WORLD.frames(8, hidden=True), WORLD.frames(9)]

    values = {**START, "lost_after": 4, "lost_score": 0.8}
    percepts = [p for p in drive(CorrelationTracker, messages, values) if p]

    assert [int(p.ids[0]) for p in percepts] == [-1] * 8 + [9, 9]
    assert percepts[5].boxes.tolist() == percepts[7].boxes.tolist()
    assert percepts[7].scores[0] < 0.8


def test_a_successor_with_the_state_continues_as_its_predecessor_would():
    old, successor = opened(**START), opened(**START)
    for k in range(10):
        old.on_context_roi(**WORLD.frames(k))

    successor.restore(loads(type(old.state()), dumps(old.state())))

    for k in range(10, 20):
        ours, theirs = (s.on_context_roi(**WORLD.frames(k)) for s in (successor, old))
        assert overlap(ours) > 0.8
        np.testing.assert_array_equal(ours.boxes, theirs.boxes)


def test_a_successor_with_another_method_starts_on_the_box_of_the_state():
    old, successor = opened(**START), opened()
    for k in range(10):
        old.on_context_roi(**WORLD.frames(k))

    successor.restore(replace(old.state(), memory=(np.zeros((1, 3, 128, 128), np.float32),)))

    assert min(overlap(successor.on_context_roi(**WORLD.frames(k))) for k in range(10, 15)) > 0.5


def test_a_new_stream_starts_again_on_the_box_that_was_set():
    subject = opened(**START)
    for k in range(5):
        subject.on_context_roi(**WORLD.frames(k))

    subject.on_stream(header(0, stream="other"))
    percept = subject.on_context_roi(**WORLD.frames(0))

    assert percept.boxes.tolist() == [list(START["init_box"])]


def test_a_box_of_the_command_follow_has_priority_over_the_policy():
    subject, percepts = opened(), []
    for k in range(30):
        subject.on_scanpath(**WORLD.scanpath(k - 1, object_id=3, box=WORLD.other_box()))
        if k == 2:
            outcome = told(subject, "follow", box=WORLD.box(2).tolist())
        percepts.append(subject.on_context_roi(**WORLD.frames(k)))

    assert outcome == {"following": WORLD.box(2).tolist()}
    assert min(overlap(p) for p in percepts[2:]) > 0.8
    assert percepts[-1].ids.tolist() == [-1]


def test_reset_drops_the_object_and_starts_again_on_that_of_the_policy():
    subject = opened(**START)
    subject.on_context_roi(**WORLD.frames(0))
    subject.on_scanpath(**WORLD.scanpath(0, object_id=3, box=WORLD.other_box()))

    outcome = told(subject, "reset")
    there = subject.on_context_roi(**WORLD.frames(1, at=WORLD.other_box()[:2]))

    assert outcome == {"forgotten": 1}
    assert there.ids.tolist() == [3]
    assert there.boxes.tolist() == [WORLD.other_box().tolist()]


@pytest.mark.parametrize("box", [[5, 5, 5, 9], [5, 5, 1, 9], [0, 0, 0, 0], [0, 0, 9, 1e30]])
def test_an_invalid_box_is_refused_and_changes_nothing(box):
    subject = opened(**START)
    subject.on_context_roi(**WORLD.frames(0))

    with pytest.raises(SettingsError, match=r"follow\.box: expected left, top, right, bottom"):
        told(subject, "follow", box=box)

    assert overlap(subject.on_context_roi(**WORLD.frames(1))) > 0.8


def test_an_invalid_initial_box_is_refused():
    with pytest.raises(SettingsError, match="init_box: expected left, top, right, bottom"):
        CorrelationSettings(init_box=(5.0, 5.0, 5.0, 9.0))


def test_a_negative_count_of_places_is_refused():
    with pytest.raises(SettingsError, match="place_after: must not be negative, got -1"):
        CorrelationSettings(place_after=-1)


@pytest.mark.parametrize("name", ["lost_after", "drift_after", "switch_after", "hidden_after"])
def test_a_count_below_one_is_refused(name):
    with pytest.raises(SettingsError, match=f"{name}: must be at least 1, got 0"):
        CorrelationSettings(**{name: 0})


def test_thresholds_change_while_it_runs():
    subject = opened(**START)
    subject.on_context_roi(**WORLD.frames(0))

    subject.on_settings(CorrelationSettings(**START, lost_score=1.0, lost_after=1))
    percept = subject.on_context_roi(**WORLD.frames(1))

    assert len(percept.boxes) == 0


def test_a_lost_object_is_shown_in_the_status_line_and_counted_in_the_report():
    subject = opened(**START)
    before = subject.headline()
    for k in range(10):
        subject.on_context_roi(**WORLD.frames(k, hidden=k > 3))

    figures = subject.summary()["tracker"]
    assert before == ""
    assert subject.headline() == "tracker: lost"
    assert figures["frames"] == 10
    assert 4 <= figures["answered"] < 10
    assert figures["let_go"]["missed"] == 1


def test_the_same_frames_give_the_same_boxes():
    frames = [WORLD.frames(k) for k in range(6)]

    first, second = (drive(CorrelationTracker, frames, START) for _ in range(2))

    np.testing.assert_array_equal([p.boxes for p in first], [p.boxes for p in second])
