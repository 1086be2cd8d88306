"""Carriers: a hidden target moves with the person who carries it."""

from functools import reduce

import numpy as np

from operators.policy.carrier import PEOPLE, can_carry, carrier_of
from operators.policy.conditioning import encode_place
from operators.policy.decision import PolicyState, Rules, observe
from operators.policy.gaze_plan import PLACE
from operators.policy.target import (
    CARRIED_AT_MOST,
    Choice,
    TargetSpec,
    TargetState,
    carrier_row,
    follow,
)
from pipeline import Tracks
from tests.operators.policy.made_up import tracks

LOOKS = np.zeros((4, 5), np.float32)
BALL = TargetSpec(box=(92, 92, 108, 108))
SMALL = TargetSpec(box=(94, 94, 106, 106))  # too small to be taken for its carrier
CROWD = [(k, 1, 300.0 + 100 * k, 500.0, 0.0) for k in (12, 13, 14, 15)]


def someone(
    frame: int, speed: float = 5.0, y: float = 105.0
) -> tuple[int, int, float, float, float]:
    return (7, 1, 100 + frame * speed, y, speed)


def after(*frames: Tracks, spec: TargetSpec = BALL) -> TargetState:
    return reduce(
        lambda target, world: follow(target, spec, world, Choice()), frames, TargetState()
    )


def caught(frames: int, y: float = 105.0) -> list[Tracks]:
    """Return frames in which the ball is seen three times in front of a person, then not again."""
    seen = [tracks(k, (1, 0, 100 + 5 * k, 100, 5), someone(k, y=y), *CROWD) for k in range(3)]
    return seen + [tracks(k, someone(k, y=y), *CROWD) for k in range(3, frames)]


def test_a_box_in_the_upper_part_of_a_larger_person_is_carried_by_that_person() -> None:
    world = tracks(0, (7, 1, 100, 105, 0), (8, 1, 110, 85, 0), (9, 0, 100, 100, 0))
    could = can_carry(world, PEOPLE, "ball")

    assert carrier_of(np.array([92, 92, 108, 108], np.float32), world, could) == 7
    assert (
        carrier_of(np.array([92, 110, 108, 126], np.float32), world, could) == -1
    )  # at their feet
    assert carrier_of(np.array([80, 85, 120, 125], np.float32), world, could) == -1  # as large
    assert not can_carry(world, PEOPLE, "player").any()


def test_the_place_moves_with_the_carrier_as_long_as_it_is_tracked() -> None:
    frames = caught(90)
    target = after(*frames)

    spot = encode_place(target, BALL, frames[-1], LOOKS, patience=24)

    assert carrier_row(target, frames[-1]) == 0
    assert target.box.tolist() == [92 + 5 * 89, 92, 108 + 5 * 89, 108]
    assert spot is not None
    assert spot.ids.tolist() == [PLACE]
    assert spot.path[0, :2].tolist() == [[542, 92, 558, 108], [547, 92, 563, 108]]


def test_a_target_at_the_feet_of_a_person_stays_when_the_person_leaves() -> None:
    frames = caught(10, y=85)
    target = after(*frames)

    assert carrier_row(target, frames[-1]) == -1
    assert target.box.tolist() == [102, 92, 118, 108]


def test_one_detection_does_not_make_a_carrier_but_a_prompt_does() -> None:
    passing = [tracks(0, (1, 0, 100, 100, 5), *CROWD)]
    passing += [tracks(1, (1, 0, 105, 100, 5), someone(1), *CROWD)]
    passing += [tracks(2, someone(2), *CROWD)]
    prompted = [tracks(k, someone(k), *CROWD) for k in range(3)]

    assert carrier_row(after(*passing), passing[-1]) == -1
    assert carrier_row(after(*prompted, spec=SMALL), prompted[-1]) == 0


def test_a_target_that_is_seen_has_no_carrier() -> None:
    world = tracks(9, (1, 0, 145, 100, 5), someone(9), *CROWD)

    assert carrier_row(after(*caught(9), world), world) == -1


def test_a_carrier_that_is_gone_carries_nothing_until_it_is_back() -> None:
    gone, back = tracks(9, *CROWD), tracks(10, someone(10), *CROWD)

    assert carrier_row(after(*caught(9), gone), gone) == -1
    assert carrier_row(after(*caught(9), gone, back), back) == 0
    assert after(*caught(9), gone, back).box.tolist() == [142, 92, 158, 108]


def test_the_place_is_with_the_carrier_also_when_frames_are_left_out() -> None:
    frames = caught(30)
    some = [*frames[:3], *frames[3::4]]

    assert after(*some).box.tolist() == [92 + 5 * 27, 92, 108 + 5 * 27, 108]
    assert after(*some).at_seq == 27


def test_a_carrier_is_dropped_after_the_longest_time_allowed() -> None:
    frames = caught(CARRIED_AT_MOST + 5)

    assert carrier_row(after(*frames[:-3]), frames[-4]) == 0
    assert carrier_row(after(*frames), frames[-1]) == -1


def test_an_unseen_track_of_the_target_is_no_candidate_while_it_is_carried() -> None:
    coasting = tracks(3, (1, 0, 195, 100, 30), someone(3), *CROWD, unseen=(1,))
    state = PolicyState(spec=BALL, target=after(*caught(3)))

    _, candidates, _ = observe(state, coasting, Rules(roi_channels=5))

    assert candidates.ids.tolist() == [7, *(row[0] for row in CROWD), PLACE]


def test_there_is_no_carrier_when_no_class_may_carry() -> None:
    spec = TargetSpec(box=BALL.box, carriers=())
    frames = caught(10)

    assert carrier_row(after(*frames, spec=spec), frames[-1]) == -1


def test_a_track_that_is_only_predicted_does_not_end_the_carrying() -> None:
    seen = caught(3)
    coasting = [
        tracks(k, (1, 0, 105 + 30 * k, 100, 30), someone(k), *CROWD, unseen=(1,))
        for k in range(3, 6)
    ]
    target = after(*seen, *coasting)

    assert target.bound_id == 1
    assert target.box.tolist() == [117, 92, 133, 108]
