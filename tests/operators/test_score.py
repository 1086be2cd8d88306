"""Score: the overlap of what was followed with what is really there."""

import numpy as np
import pytest

from operators.score import Score, ScoreSettings
from pipeline import Percept, SettingsError
from pipeline.testing import header

BALL, REFEREE = (100.0, 100.0, 120.0, 120.0), (300.0, 100.0, 340.0, 200.0)


def truth(seq: int, *, visible: float = 1.0) -> Percept:
    return Percept(
        header=header(seq),
        boxes=np.array([BALL, REFEREE], np.float32),
        ids=np.array([7, 9], np.int32),
        scores=np.array([visible, 1.0], np.float32),
        texts=("ball", "main referee"),
    )


def percept(seq: int, box: tuple[float, ...] | None, object_id: int = 1) -> Percept:
    boxes = np.array([box] if box else [], np.float32).reshape(-1, 4)
    ids = np.full(len(boxes), object_id, np.int32)
    return Percept(header=header(seq), boxes=boxes, ids=ids, scores=np.ones(len(boxes), np.float32))


def scored(*pairs: tuple[Percept, Percept], **settings: object) -> Score:
    subject = Score(ScoreSettings(**settings))  # type: ignore[arg-type]
    subject.open()
    for seen, real in pairs:
        subject.on_percept_truth(seen, real)
    return subject


def test_it_compares_with_whoever_was_followed_first() -> None:
    half = (110.0, 100.0, 130.0, 120.0)
    subject = scored((percept(0, BALL), truth(0)), (percept(1, half), truth(1)))

    assert subject.summary()["iou"] == {"mean": pytest.approx((1 + 1 / 3) / 2, 1e-3), "frames": 2}


def test_following_another_object_is_a_miss_unless_the_consumer_says_so() -> None:
    lost = scored((percept(0, BALL), truth(0)), (percept(1, REFEREE), truth(1)))
    anew = scored((percept(0, BALL), truth(0)), (percept(1, REFEREE, object_id=2), truth(1)))

    assert lost.summary()["iou"]["mean"] == 0.5
    assert anew.summary()["iou"]["mean"] == 1.0


def test_a_class_can_be_asked_for_whoever_is_followed() -> None:
    subject = scored((percept(0, REFEREE), truth(0)), label="ball")

    assert subject.summary()["iou"] == {"mean": 0.0, "frames": 1}


def test_frames_that_hide_the_object_or_show_nothing_do_not_count() -> None:
    subject = scored((percept(0, BALL), truth(0, visible=0.1)), (percept(1, None), truth(1)))

    assert subject.summary() == {}
    assert subject.headline() == ""


def test_the_headline_tells_the_figure_of_now() -> None:
    assert scored((percept(0, BALL), truth(0))).headline() == "IoU 1.00"


def test_a_share_beyond_the_whole_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"least_visible: must be within 0\.\.1, got 2"):
        ScoreSettings(least_visible=2)
