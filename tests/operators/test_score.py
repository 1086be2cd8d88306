"""Score: the overlap of the followed object with the truth."""

from dataclasses import replace

import numpy as np
import pytest

from operators.score import SETTLED, Score, ScoreSettings
from pipeline import MessageError, Percept, Scanpath, SettingsError, Truth
from pipeline.testing import header

BALL, REFEREE = (100.0, 100.0, 120.0, 120.0), (300.0, 100.0, 340.0, 200.0)


def truth(seq: int, *, visible: float = 1.0) -> Truth:
    return Truth(
        header=header(seq),
        boxes=np.array([BALL, REFEREE], np.float32),
        ids=np.array([7, 9], np.int32),
        labels=("ball", "main referee"),
        visibility=np.array([visible, 1.0], np.float32),
    )


def percept(seq: int, box: tuple[float, ...] | None, object_id: int = 1) -> Percept:
    boxes = np.array([box] if box else [], np.float32).reshape(-1, 4)
    ids = np.full(len(boxes), object_id, np.int32)
    return Percept(header=header(seq), boxes=boxes, ids=ids, scores=np.ones(len(boxes), np.float32))


def scanpath(seq: int, box: tuple[float, ...], choice: int = 4) -> Scanpath:
    """Return a scanpath whose choice for frame `seq` is an object, or a place (-1)."""
    return Scanpath(
        header=header(seq - 1),
        ids=np.array([4], np.int32),
        probability=np.ones((1, 1), np.float32),
        choice=np.array([choice], np.int32),
        boxes=np.array([box], np.float32),
        first_seq=seq,
    )


def watched(
    *frames: tuple[tuple[float, ...] | None, tuple[float, ...], int], **settings: object
) -> Score:
    """Score frames with these boxes of the consumer and the policy; a choice of -1 is a place."""
    subject = Score(ScoreSettings(**settings))  # type: ignore[arg-type]
    subject.open()
    for seq, (seen, shown, choice) in enumerate(frames):
        subject.on_scanpath(scanpath(seq, shown, choice))
        subject.on_percept_truth(percept(seq, seen), truth(seq))
    return subject


def scored(*pairs: tuple[Percept, Truth], **settings: object) -> Score:
    subject = Score(ScoreSettings(**settings))  # type: ignore[arg-type]
    subject.open()
    for seen, real in pairs:
        subject.on_percept_truth(seen, real)
    return subject


def test_it_compares_with_the_object_that_was_followed_first() -> None:
    half = (110.0, 100.0, 130.0, 120.0)
    subject = scored((percept(0, BALL), truth(0)), (percept(1, half), truth(1)))

    assert subject.summary()["iou"] == {
        "mean": pytest.approx((1 + 1 / 3) / 2, 1e-3),
        "frames": 2,
        "answered": 1.0,
    }


def test_the_headline_of_a_run_is_a_sentence() -> None:
    seen, lost = (percept(0, BALL), truth(0)), (percept(1, None), truth(1))

    assert scored(seen).summary()["headline"] == (
        "IoU 1.000 with the truth over 1 frame, a box in all of them"
    )
    assert scored(seen, lost).summary()["headline"] == (
        "IoU 0.500 with the truth over 2 frames, a box in 50.0% of them"
    )
    assert scored().summary() == {}


def test_following_another_object_is_a_miss_unless_the_id_changes() -> None:
    lost = scored((percept(0, BALL), truth(0)), (percept(1, REFEREE), truth(1)))
    anew = scored((percept(0, BALL), truth(0)), (percept(1, REFEREE, object_id=2), truth(1)))

    assert lost.summary()["iou"]["mean"] == 0.5
    assert anew.summary()["iou"]["mean"] == 1.0


def test_a_label_selects_the_true_object_whichever_is_followed() -> None:
    subject = scored((percept(0, REFEREE), truth(0)), label="ball")

    assert subject.summary()["iou"] == {"mean": 0.0, "frames": 1, "answered": 1.0}


def test_of_several_objects_with_the_label_the_followed_one_counts() -> None:
    both = Truth(
        header=header(0),
        boxes=np.array([BALL, REFEREE], np.float32),
        ids=np.array([7, 9], np.int32),
        labels=("referee", "referee"),
        visibility=np.ones(2, np.float32),
    )

    assert scored((percept(0, REFEREE), both), label="referee").summary()["iou"]["mean"] == 1.0


def test_frames_with_the_object_hidden_or_before_any_is_followed_do_not_count() -> None:
    subject = scored((percept(0, None), truth(0)), (percept(1, BALL), truth(1, visible=0.1)))

    assert subject.summary() == {}
    assert subject.headline() == ""


def test_a_lost_object_counts_as_zero_and_the_share_of_answers_is_reported() -> None:
    subject = scored(*((percept(k, BALL if k % 4 == 0 else None), truth(k)) for k in range(8)))

    assert subject.summary()["iou"] == {"mean": 0.25, "frames": 8, "answered": 0.25}


def test_losing_a_hidden_object_does_not_lower_the_score() -> None:
    hidden = (percept(1, None), truth(1, visible=0.1))

    assert scored((percept(0, BALL), truth(0)), hidden).summary()["iou"]["mean"] == 1.0


def test_the_object_that_the_policy_shows_counts_whichever_is_followed() -> None:
    subject = watched(*[(REFEREE, BALL, 4)] * 5)

    assert subject.summary()["iou"] == {"mean": 0.0, "frames": 5, "answered": 1.0}


def test_once_the_policy_shows_another_object_the_old_one_does_not_count_any_more() -> None:
    subject = watched(*[(BALL, BALL, 4)] * 4, *[(BALL, REFEREE, 8)] * 6)

    assert subject.summary()["iou"]["mean"] == pytest.approx((4 + SETTLED - 1) / 10)


def test_one_wrong_scanpath_does_not_change_what_counts() -> None:
    subject = watched(
        (BALL, BALL, 4), (BALL, REFEREE, 8), (BALL, BALL, 4), (BALL, REFEREE, 8), (BALL, REFEREE, 8)
    )

    assert subject.summary()["iou"]["mean"] == 1.0


def test_after_a_swap_what_the_policy_showed_counts_until_it_plans_again() -> None:
    before = watched(*[(REFEREE, BALL, 4)] * 5)
    after = Score(ScoreSettings())
    after.open()
    after.restore(before.state())

    for seq in range(5, 9):  # the plan comes behind the first frame
        after.on_percept_truth(percept(seq, REFEREE), truth(seq))
        after.on_scanpath(scanpath(seq + 1, BALL))

    assert after.summary()["iou"] == {"mean": 0.0, "frames": 9, "answered": 1.0}


@pytest.mark.parametrize("choice", [-1, 8])
def test_a_policy_that_looks_at_a_place_or_at_nothing_still_has_its_target(choice: int) -> None:
    shown = REFEREE if choice < 0 else (600.0, 600.0, 640.0, 640.0)
    subject = watched((BALL, BALL, 4), *[(None, shown, choice)] * 3)

    assert subject.summary()["iou"] == {"mean": 0.25, "frames": 4, "answered": 0.25}


def test_the_label_can_be_changed_while_it_runs() -> None:
    subject = watched((BALL, BALL, 4), label="ball")

    subject.on_settings(ScoreSettings(label="main referee"))
    subject.on_percept_truth(percept(1, BALL), truth(1))

    assert subject.summary()["iou"]["mean"] == 0.5


def test_the_headline_in_the_status_line_is_the_recent_overlap() -> None:
    assert scored((percept(0, BALL), truth(0))).headline() == "IoU 1.00"


def test_a_share_above_one_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"least_visible: must be within 0\.\.1, got 2"):
        ScoreSettings(least_visible=2)


@pytest.mark.parametrize("labels", [(), ("ball",), ("ball", "main referee", "player")])
def test_a_truth_whose_labels_do_not_fit_its_boxes_is_refused(labels: tuple[str, ...]) -> None:
    score = Score(ScoreSettings(label="player"))
    score.open()

    with pytest.raises(MessageError, match=f"expected one for each box, got {len(labels)} for 2"):
        score.on_percept_truth(percept(0, BALL), replace(truth(0), labels=labels))
