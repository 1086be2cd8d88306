"""When a tracker drops its object: the boxes of the policy against those of the method."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.tracker import CorrelationSettings, CorrelationTracker, TrackerState
from pipeline import Percept, Scanpath
from pipeline.boxes import centres, iou
from pipeline.codec import dumps, loads
from pipeline.testing import drive, header
from tests.operators.tracker.made_up import AWAY, World

WORLD = World(seed=11)
FAST = World(seed=11, step=(90, 20))  # farther in a frame than a search around its last place
OTHER = WORLD.other_box()
SWITCH, DRIFT, HIDDEN, PLACE = 3, 6, 4, 12
RULES = {
    "switch_after": SWITCH, "drift_after": DRIFT, "hidden_after": HIDDEN, "place_after": PLACE,
}  # fmt: skip
# id and box or boxes (None: the object's) of a scanpath; None: no scanpath
Show = tuple[int, NDArray[np.float32] | None] | None


def play(
    shows: Callable[[int], Show],
    frames: int,
    *,
    looks: Callable[[int], NDArray[np.float32] | None] = lambda k: None,
    hidden: Callable[[int], bool] = lambda k: False,
    world: World = WORLD,
) -> list[Percept]:
    """Play frames, a scanpath before each; the ROI is on the object unless `looks` has a place."""
    messages: list[dict[str, object]] = []
    for k in range(frames):
        if (shown := shows(k)) is not None:
            messages.append(dict(world.scanpath(k - 1, object_id=shown[0], box=shown[1])))
        messages.append(dict(world.frames(k, at=looks(k), hidden=hidden(k))))
    answers = drive(CorrelationTracker, messages, RULES)  # type: ignore[arg-type]
    return [answer for answer in answers if answer is not None]


def begun(settings: CorrelationSettings) -> CorrelationTracker:
    """A tracker that follows the object, shown as number 3, since frame 0."""
    subject = CorrelationTracker(settings)
    subject.open()
    subject.on_stream(header(0))
    subject.on_scanpath(**WORLD.scanpath(-1, object_id=3))
    assert on_object(subject.on_context_roi(**WORLD.frames(0)))
    return subject


def on_object(percept: Percept, world: World = WORLD) -> bool:
    return (
        bool(len(percept.boxes)) and iou(percept.boxes, world.box(percept.header.seq)[None]) > 0.5
    )


def on_other(percept: Percept) -> bool:
    return bool(len(percept.boxes)) and iou(percept.boxes, OTHER[None]) > 0.5


def test_another_target_is_followed_once_it_was_shown_for_some_frames() -> None:
    percepts = play(
        lambda k: (3, None) if k < 10 else (8, OTHER),
        20,
        looks=lambda k: None if k < 10 else centres(OTHER),
    )

    assert all(on_object(p) for p in percepts[1 : 10 + SWITCH - 1])
    assert all(on_other(p) for p in percepts[10 + SWITCH - 1 :])
    assert [int(p.ids[0]) for p in percepts[-2:]] == [8, 8]


def test_a_set_that_has_waited_is_judged_by_the_plan_of_its_frame_and_not_by_a_later_one() -> None:
    percepts = drive(CorrelationTracker, [
        WORLD.scanpath(4, object_id=3), WORLD.scanpath(5, object_id=8, box=OTHER), WORLD.frames(5),
        WORLD.frames(6, at=centres(OTHER)),
    ])  # fmt: skip

    first, second = (percept for percept in percepts if percept is not None)
    assert first.ids.tolist() == [3]
    assert on_object(first)
    assert second.ids.tolist() == [3]  # `switch_after` 2


def test_one_wrong_scanpath_changes_nothing() -> None:
    percepts = play(lambda k: (8, OTHER) if k in (6, 9, 10) else (3, None), 16)

    assert all(on_object(p) for p in percepts)
    assert {int(p.ids[0]) for p in percepts} == {3}


def test_another_id_for_the_same_object_is_taken_over_without_starting_again() -> None:
    percepts = play(lambda k: (3 if k < 8 else 5, None), 12)

    assert all(on_object(p) for p in percepts)
    assert [int(p.ids[0]) for p in percepts] == [3] * 8 + [5] * 4
    assert sum(p.scores[0] == 1 for p in percepts) == 1


def test_a_tracker_that_drifted_beside_the_object_is_brought_back() -> None:
    percepts = play(lambda k: (3, OTHER) if k == 0 else (3, None), 14, looks=lambda k: (
        centres(OTHER) if k == 0 else None
    ))  # fmt: skip

    assert all(on_other(p) for p in percepts[:DRIFT])
    assert all(on_object(p) for p in percepts[DRIFT:])


def test_an_object_too_fast_for_a_search_is_found_where_the_policy_foresees_it() -> None:
    with_plans = play(lambda k: (3, None), 8, world=FAST)
    on_its_own = play(lambda k: (3, None) if k == 0 else None, 8, world=FAST)

    assert all(on_object(p, FAST) for p in with_plans)
    assert not any(on_object(p, FAST) for p in on_its_own[4:])  # the plan speaks of four frames


def test_a_slow_object_is_searched_where_it_was_wherever_it_is_foreseen() -> None:
    percepts = play(lambda k: (3, OTHER) if k == 6 else (3, None), 12)

    found = [float(iou(p.boxes, WORLD.box(k)[None])[0, 0]) for k, p in enumerate(percepts)]
    assert min(found) > 0.8  # a box that stays for a frame has less


def test_an_object_foreseen_fast_and_elsewhere_is_soon_searched_where_it_was() -> None:
    still = World(seed=11, step=(0, 0))
    leaving = np.stack([OTHER + 90 * k for k in range(4)])
    percepts = play(lambda k: (3, leaving if 4 <= k < 3 + DRIFT else None), 14, world=still)

    assert all(on_object(p, still) for p in percepts)


def test_an_object_out_of_sight_is_lost_and_not_guessed_and_found_again_when_it_is_shown() -> None:
    percepts = play(
        lambda k: (3, None) if k < 6 or k >= 16 else (-1, WORLD.box(6)),
        20,
        hidden=lambda k: 6 <= k < 16,
    )

    assert all(on_object(p) for p in percepts[:6])
    assert all(len(p.boxes) == len(p.ids) == len(p.scores) == 0 for p in percepts[12:16])
    assert all(on_object(p) for p in percepts[16:])


def test_an_object_outside_the_roi_is_lost_while_the_policy_shows_a_place() -> None:
    percepts = play(
        lambda k: (3, None) if k < 6 else (-1, np.array([1480, 880, 1520, 920], np.float32)),
        16,
        looks=lambda k: None if k < 6 else AWAY,
    )

    assert all(on_object(p) for p in percepts[: 6 + HIDDEN - 1])
    assert all(len(p.boxes) == 0 for p in percepts[6 + HIDDEN - 1 :])


def test_an_object_inside_the_roi_is_followed_until_the_policy_has_shown_a_place_for_long() -> None:
    percepts = play(lambda k: (3, None) if k < 6 or k >= 24 else (-1, WORLD.box(k)), 30)

    assert all(on_object(p) for p in percepts[: 6 + PLACE - 1])
    assert all(len(p.boxes) == 0 for p in percepts[6 + PLACE - 1 : 24])
    assert all(on_object(p) for p in percepts[24:])


def test_places_between_frames_that_show_the_object_change_nothing() -> None:
    percepts = play(lambda k: (3, None) if k % PLACE == 0 else (-1, WORLD.box(k)), 40)

    assert all(on_object(p) for p in percepts)


def test_without_new_scanpaths_the_object_is_followed() -> None:
    percepts = play(lambda k: (3, None) if k < 3 else None, 40)

    assert all(on_object(p) for p in percepts)


def test_an_object_is_not_followed_before_the_roi_shows_it() -> None:
    percepts = play(lambda k: (3, None), 10, looks=lambda k: AWAY if k < 5 else None)

    assert [len(p.boxes) for p in percepts] == [0] * 5 + [1] * 5


@pytest.mark.parametrize("choice", [-1, 3])
def test_a_place_and_a_scanpath_that_has_ended_start_no_following(choice: int) -> None:
    messages = [WORLD.scanpath(0, object_id=choice), WORLD.frames(1 if choice < 0 else 5)]

    percepts = drive(CorrelationTracker, messages)

    assert len(percepts[-1].boxes) == 0


def test_a_successor_continues_the_counts_of_its_predecessor() -> None:
    old, successor = begun(CorrelationSettings(**RULES)), begun(CorrelationSettings(**RULES))
    for k in range(1, SWITCH):
        old.on_scanpath(**WORLD.scanpath(k - 1, object_id=8, box=OTHER))
        assert on_object(old.on_context_roi(**WORLD.frames(k)))

    successor.restore(loads(TrackerState, dumps(old.state())))
    successor.on_scanpath(**WORLD.scanpath(SWITCH - 1, object_id=8, box=OTHER))

    assert on_other(successor.on_context_roi(**WORLD.frames(SWITCH, at=centres(OTHER))))


def test_places_are_counted_on_by_a_successor_and_reported() -> None:
    old, successor = begun(CorrelationSettings(**RULES)), begun(CorrelationSettings(**RULES))
    for k in range(1, PLACE):
        old.on_scanpath(**WORLD.scanpath(k - 1, object_id=-1))
        assert on_object(old.on_context_roi(**WORLD.frames(k)))

    successor.restore(loads(TrackerState, dumps(old.state())))
    successor.on_scanpath(**WORLD.scanpath(PLACE - 1, object_id=-1))

    assert not len(successor.on_context_roi(**WORLD.frames(PLACE)).boxes)
    assert successor.summary()["tracker"]["let_go"]["place"] == 1


def test_an_object_that_was_given_and_one_of_a_tracker_without_the_rule_outlast_places() -> None:
    given_box = tuple(WORLD.box(0).tolist())
    for settings in (
        CorrelationSettings(**RULES, init_box=given_box),
        CorrelationSettings(**RULES | {"place_after": 0}),
    ):
        subject = begun(settings)
        for k in range(1, 2 * PLACE):
            subject.on_scanpath(**WORLD.scanpath(k - 1, object_id=-1))
            assert on_object(subject.on_context_roi(**WORLD.frames(k)))


@given(
    st.lists(
        st.tuples(
            st.integers(-3, 4),
            st.lists(st.floats(width=32), min_size=4, max_size=4),
        ),
        min_size=4,
        max_size=4,
    )
)
def test_for_any_scanpath_the_answer_is_one_box_or_none(
    rows: list[tuple[int, list[float]]],
) -> None:
    subject = CorrelationTracker(CorrelationSettings(drift_after=1, switch_after=1))
    subject.open()
    subject.on_stream(header(0))
    scanpath = Scanpath(
        header=header(0),
        ids=np.zeros(0, np.int32),
        probability=np.zeros((4, 0), np.float32),
        choice=np.array([choice for choice, _ in rows], np.int32),
        boxes=np.array([box for _, box in rows], np.float32),
        first_seq=1,
    )

    subject.on_scanpath(scanpath)
    percepts = [subject.on_context_roi(**WORLD.frames(k, roi=False)) for k in range(1, 5)]

    for percept in percepts:
        assert len(percept.boxes) in (0, 1)
        assert np.isfinite(percept.boxes).all()
        assert len(percept.ids) == len(percept.scores) == len(percept.boxes)
