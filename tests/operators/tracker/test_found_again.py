"""An object that the tracker has lost is answered where a detector in the ROI keeps finding it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.tracker import CorrelationSettings, CorrelationTracker, TrackerState
from pipeline import Detections, Percept, SettingsError
from pipeline.boxes import iou
from pipeline.codec import dumps, loads
from pipeline.testing import header
from tests.operators.tracker.made_up import AWAY, World

WORLD = World(seed=11, step=(0, 0))
BOX = WORLD.box(0)
PLACE = BOX + 60  # where the object is found again, within the ROI around its last place
SIDE = np.array([50, 0, 50, 0], np.float32)
LOST = 6  # the frame from which it is hidden
RULES = {"lost_after": 3, "switch_after": 2, "found_for": 10}
Box = NDArray[np.float32]


def finds(seq: int, *boxes: Box, score: float = 0.9, label: int = 1) -> Detections:
    count = len(boxes)
    return Detections(
        header=header(seq), boxes=np.array(boxes, np.float32).reshape(count, 4),
        angles=np.zeros(count, np.float32), scores=np.full(count, score, np.float32),
        labels=np.full(count, label, np.int32), features=np.zeros((count, 0), np.float32),
        names=("player", "ball"),
    )  # fmt: skip


def there(seq: int) -> Detections:
    """Return the object where it is followed, and later where it is found again."""
    return finds(seq, BOX if seq < LOST else PLACE)


class Run:
    """A tracker that follows an object until it is hidden, while the policy shows a place."""

    def __init__(self, found: Callable[[int], Detections] = there, **rules: int) -> None:
        self.subject = CorrelationTracker(CorrelationSettings(**RULES | rules))
        self.subject.open()
        self.subject.on_stream(header(0))
        self.found, self.seq = found, 0

    def until(self, seq: int, object_id: int = -1, box: Box = BOX) -> list[Percept]:
        """Play up to a frame; return the percepts."""
        percepts = []
        while self.seq < seq:
            shown_id, shown = (3, BOX) if self.seq < LOST else (object_id, box)
            plan = WORLD.scanpath(self.seq - 1, object_id=shown_id, box=shown)
            self.subject.on_scanpath(**plan)
            frames = WORLD.frames(self.seq, hidden=self.seq >= LOST)
            percepts.append(self.subject.on_context_roi(**frames))
            self.subject.on_finds(self.found(self.seq))  # in lockstep after the set of its frame
            self.seq += 1
        return percepts


def at(percept: Percept, box: Box) -> bool:
    return len(percept.boxes) == 1 and iou(percept.boxes, box[None]).item() > 0.9


def test_a_lost_object_is_answered_where_it_is_found_and_how_sure_that_is() -> None:
    run = Run()

    percepts = run.until(LOST + 6)

    assert all(at(p, BOX) for p in percepts[: LOST + 2])  # `lost_after` 3
    assert all(at(p, PLACE) for p in percepts[LOST + 2 :])
    assert [p.ids.tolist() for p in percepts[-4:]] == [[-1]] * 4
    ratings = [float(p.scores[0]) for p in percepts[-4:]]
    assert ratings == pytest.approx([0.9 * (1 - 0.7**n) for n in (2, 3, 4, 5)])
    assert run.subject.summary()["tracker"]["found"] == 4
    assert run.subject.headline() == ""


def test_an_object_that_the_policy_shows_comes_before_what_is_found() -> None:
    run = Run()
    run.until(LOST + 6)

    percepts = run.until(LOST + 9, object_id=8, box=BOX)

    assert all(p.ids.tolist() == [8] for p in percepts)


@pytest.mark.parametrize(
    "found",
    [
        lambda k: finds(k, PLACE, label=1 if k < LOST else 0),  # another class
        lambda k: finds(
            k, BOX if k < LOST else PLACE + SIDE * (k % 4), score=0.6
        ),  # here and there
        lambda k: finds(k, *([PLACE] if k % 4 == 0 else [])),  # now and then
        lambda k: finds(k, BOX if k < LOST else PLACE, score=0.9 if k < LOST else 0.2),  # unsure
        lambda k: finds(
            k, BOX if k < LOST else np.concatenate([AWAY, AWAY + 40])
        ),  # not in the ROI
        lambda k: finds(k),  # nothing
        lambda k: finds(k, *([PLACE] if k >= LOST else [])),  # it never told what the object is
    ],
)
def test_what_may_be_something_else_is_no_answer(found: Callable[[int], Detections]) -> None:
    percepts = Run(found).until(LOST + 8)

    assert all(at(p, BOX) for p in percepts[: LOST + 2])
    assert all(len(p.boxes) == 0 for p in percepts[LOST + 2 :])


def test_an_object_that_was_lost_long_ago_is_no_longer_answered() -> None:
    percepts = Run().until(LOST + 20)

    assert [len(p.boxes) for p in percepts[LOST + 2 :]] == [1] * 10 + [0] * 8
    assert all(len(p.boxes) == 0 for p in Run(found_for=0).until(LOST + 8)[LOST + 2 :])
    with pytest.raises(SettingsError, match="found_for: must not be negative, got -1"):
        CorrelationSettings(found_for=-1)


def test_once_the_policy_has_shown_another_object_the_first_one_is_not_answered() -> None:
    run = Run(lost_after=50)

    percepts = run.until(LOST + 8, object_id=8, box=WORLD.other_box())  # which the ROI never shows

    assert all(at(p, BOX) for p in percepts[: LOST + 1])  # `switch_after` 2
    assert all(len(p.boxes) == 0 for p in percepts[LOST + 1 :])


def test_what_stands_where_the_object_was_gives_it_no_other_class() -> None:
    def found(seq: int) -> Detections:
        there = finds(seq, BOX, PLACE)
        labels = np.array([1 if seq < LOST else 0, 1], np.int32)  # a player, from then on
        return replace(there, labels=labels)

    percepts = Run(found).until(LOST + 8)

    assert all(at(p, PLACE) for p in percepts[LOST + 2 :])


def test_an_object_that_was_given_is_not_answered_once_it_is_lost() -> None:
    run = Run()
    run.subject.do_follow(tuple(BOX.tolist()))

    percepts = run.until(LOST + 8)

    assert all(at(p, BOX) for p in percepts[: LOST + 2])
    assert all(len(p.boxes) == 0 for p in percepts[LOST + 2 :])


def test_reset_and_another_stream_forget_what_was_found() -> None:
    for forget in ("reset", "stream"):
        run = Run()
        assert at(run.until(LOST + 6)[-1], PLACE)
        if forget == "reset":
            run.subject.do_reset()
        else:
            run.subject.on_stream(header(0))
        assert all(len(p.boxes) == 0 for p in run.until(LOST + 9))


def test_a_successor_answers_what_its_predecessor_would() -> None:
    run, successor = Run(), Run()
    run.until(LOST + 4)

    successor.subject.restore(loads(TrackerState, dumps(run.subject.state())))
    successor.seq = run.seq

    for own, other in zip(run.until(LOST + 16), successor.until(LOST + 16), strict=True):
        assert own.boxes.tolist() == other.boxes.tolist()
        assert own.scores.tolist() == other.scores.tolist()


def test_a_lost_object_is_not_answered_by_finds_of_long_ago() -> None:
    run = Run()
    assert at(run.until(LOST + 6)[-1], PLACE)

    later = [run.subject.on_context_roi(**WORLD.frames(run.seq + k, hidden=True)) for k in range(4)]

    assert [len(p.boxes) for p in later] == [1, 1, 0, 0]  # of the frames next to the last finds


def test_another_object_that_the_policy_shows_after_the_loss_ends_the_answers() -> None:
    run = Run()
    assert at(run.until(LOST + 5)[-1], PLACE)

    percepts = run.until(LOST + 9, object_id=8, box=WORLD.other_box())  # which the ROI never shows

    assert [len(p.boxes) for p in percepts] == [1, 0, 0, 0]  # `switch_after` 2
    assert all(len(p.boxes) == 0 for p in run.until(LOST + 12))


def test_the_object_that_was_lost_may_be_shown_elsewhere_without_an_end() -> None:
    run = Run()
    run.until(LOST + 5)

    successor = Run()
    successor.subject.restore(loads(TrackerState, dumps(run.subject.state())))
    successor.seq = run.seq

    for one in (run, successor):
        assert all(at(p, PLACE) for p in one.until(LOST + 9, object_id=3, box=WORLD.other_box()))


def test_a_tracker_beside_the_object_gives_it_no_other_class() -> None:
    """The policy shows the object elsewhere, and then a place."""

    def found(seq: int) -> Detections:
        labels = np.array([1 if seq < 3 else 0, 1], np.int32)  # from then on a player is there
        return replace(finds(seq, BOX, PLACE), labels=labels)

    run = Run(found, place_after=6, lost_after=50)
    run.until(3)
    for k in range(3, 14):
        shown = {"object_id": 3, "box": WORLD.other_box()} if k < 5 else {"object_id": -1}
        run.subject.on_scanpath(**WORLD.scanpath(k - 1, **shown))  # type: ignore[arg-type]
        percept = run.subject.on_context_roi(**WORLD.frames(k))
        run.subject.on_finds(found(k))

    assert at(percept, PLACE)


def test_what_stands_there_gives_a_missed_object_no_other_class_without_a_policy_either() -> None:
    run = Run(lost_after=6)
    run.until(LOST)
    for k in range(LOST, LOST + 9):  # the policy has ended, its last plan ends before the loss
        percept = run.subject.on_context_roi(**WORLD.frames(k, hidden=True))
        labels = np.array([0, 1], np.int32)
        run.subject.on_finds(replace(finds(k, BOX, PLACE), labels=labels))

    assert at(percept, PLACE)


def test_what_one_of_several_windows_shows_is_answered() -> None:
    run = Run()
    run.until(LOST + 5)

    frames = WORLD.frames(run.seq, hidden=True)
    away = WORLD.frames(run.seq, hidden=True, at=AWAY)["roi"]
    run.subject.on_scanpath(**WORLD.scanpath(run.seq - 1, object_id=-1, box=box_at(AWAY)))
    percept = run.subject.on_context_roi_roi_2(**frames, roi_2=away)

    assert at(percept, PLACE)


def box_at(middle: NDArray[np.float32]) -> Box:
    return np.concatenate([middle - 20, middle + 20]).astype(np.float32)
