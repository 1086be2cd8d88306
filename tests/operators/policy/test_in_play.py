"""Candidates in play: what moves, or has a person near and has not rested for long."""

import numpy as np
import pytest

from operators.policy import PursuitPolicy, PursuitPolicySettings
from operators.policy.in_play import (
    CAPACITY,
    FORGOTTEN,
    IN_PLAY,
    RESTED,
    SCENERY,
    in_play,
    no_places,
    play_odds,
    rested,
)
from operators.policy.target import TargetSpec
from pipeline import Tracks
from pipeline.testing import drive
from tests.operators.policy.made_up import tracks

BALL = TargetSpec(label="ball")
PERSON = (9, 1, 300.0, 300.0, 0.0)  # 40 px tall
Row = tuple[int, int, float, float, float]


def playing(*objects: Row, seq: int = 0, unseen: tuple[int, ...] = ()) -> list[bool]:
    """Return which objects of a first frame are in play."""
    return in_play(tracks(seq, *objects, unseen=unseen), BALL, no_places()).tolist()


@pytest.mark.parametrize(
    ("ball", "expected"),
    [
        ((1, 0, 312.0, 316.0, 0.0), True),
        ((1, 0, 400.0, 300.0, 0.0), False),
        ((1, 0, 400.0, 300.0, 5.0), True),
        ((1, 0, 400.0, 300.0, 1.0), False),
    ],
    ids=["at somebody's feet", "alone", "alone, it rolls", "alone, it jitters"],
)
def test_a_ball_is_in_play_if_it_moves_or_a_person_is_near(ball: Row, expected: bool):
    assert playing(ball, PERSON)[0] is expected


def test_a_person_who_is_not_seen_is_near_to_nothing():
    assert not playing((1, 0, 312.0, 316.0, 0.0), PERSON, unseen=(9,))[0]


def test_what_moves_with_the_camera_does_not_move():
    world = [(k, 0, 100.0 * k, 900.0, 7.0) for k in range(1, 6)]

    assert playing(*world) == [False] * 5
    assert playing(*world, (7, 0, 1500.0, 100.0, 1.0))[-1]


def test_a_ball_that_rests_for_long_is_scenery_until_it_moves():
    rests, rolls = (1, 0, 312.0, 316.0, 0.0), (1, 0, 322.0, 316.0, 5.0)
    places, seen = no_places(), []
    for seq in range(RESTED + 1):
        frame = tracks(seq, rests, PERSON)
        places = rested(places, frame, BALL)
        seen.append(bool(in_play(frame, BALL, places)[0]))

    assert seen == [True] * RESTED + [False]
    frame = tracks(RESTED + 1, rolls, PERSON)
    assert in_play(frame, BALL, rested(places, frame, BALL))[0]


def test_a_place_keeps_its_age_under_another_id_and_while_it_is_hidden():
    rests, renamed = (1, 0, 312.0, 316.0, 0.0), (2, 0, 314.0, 316.0, 0.0)
    places = rested(no_places(), tracks(0, rests, PERSON), BALL)
    frame = tracks(RESTED, renamed, PERSON)

    assert not in_play(frame, BALL, rested(places, frame, BALL))[0]


def test_a_place_without_a_candidate_is_forgotten():
    places = rested(no_places(), tracks(0, (1, 0, 312.0, 316.0, 0.0)), BALL)

    assert len(rested(places, tracks(FORGOTTEN, PERSON), BALL).at) == 1
    assert len(rested(places, tracks(FORGOTTEN + 1, PERSON), BALL).at) == 0


@pytest.mark.parametrize("seed", range(5))
def test_places_do_not_grow_without_limit(seed: int):
    rng, places = np.random.default_rng(seed), no_places()
    for seq in range(30):
        world = [(k, 0, *rng.uniform(0, 9000, 2), 0.0) for k in range(60)]
        places = rested(places, tracks(seq, *world), BALL)

    assert len(places.at) == len(places.since_seq) == len(places.seen_seq) == CAPACITY
    assert places.seen_seq.max() == 29  # the newest are kept


def test_only_candidates_of_the_class_in_sight_have_places():
    frame = tracks(0, (1, 0, 100.0, 100.0, 0.0), (2, 0, 500.0, 100.0, 0.0), PERSON, unseen=(2,))

    assert rested(no_places(), frame, BALL).at.tolist() == [[100, 100]]


def test_no_tracks_have_no_odds():
    assert play_odds(tracks(0), BALL, rested(no_places(), tracks(0), BALL)).shape == (0,)


@pytest.mark.parametrize("label", ["", "player"])
def test_people_and_any_object_are_rated_as_without(label: str):
    frame = tracks(0, (1, 0, 400.0, 300.0, 0.0), PERSON)

    assert play_odds(frame, TargetSpec(label=label), no_places()).tolist() == [0, 0]
    assert play_odds(frame, BALL, no_places())[0] == np.float32(SCENERY)


def world(seq: int) -> Tracks:
    """Return a bright spare ball that lies alone, and a faint one that a person runs with."""
    x = 300.0 + 5 * seq
    frame = tracks(seq, (1, 0, 1500.0, 800.0, 0.0), (2, 0, x, 316.0, 5.0), (9, 1, x, 300.0, 5.0))
    frame.scores[:] = (0.7, 0.3, 0.9)
    return frame


@pytest.mark.parametrize(("rule", "expected"), [(False, 1), (True, 2)])
def test_a_spare_ball_is_passed_over_for_one_in_play(rule: bool, expected: int):
    settings = {"target": "ball", "least_probability": 0.05, "in_play": rule}

    paths = drive(PursuitPolicy, [world(k) for k in range(6)], settings)

    middle = (paths[-1].boxes[0, :2] + paths[-1].boxes[0, 2:]) / 2
    wanted = (1500, 800) if expected == 1 else (330, 316)
    np.testing.assert_allclose(middle, wanted, atol=1)


def test_one_object_that_was_asked_for_is_followed_wherever_it_lies():
    settings = {"prompt_box": (1492.0, 792.0, 1508.0, 808.0), "in_play": True}

    paths = drive(PursuitPolicy, [world(k) for k in range(4)], settings)

    assert [int(path.choice[0]) for path in paths] == [1] * 4


def test_what_rests_is_known_after_a_swap():
    settings = PursuitPolicySettings(target="ball", in_play=True)
    before, after = PursuitPolicy(settings), PursuitPolicy(settings)
    before.open()
    after.open()
    before.on_tracks(tracks(0, (1, 0, 312.0, 316.0, 0.0), PERSON))

    after.restore(before.state())

    assert after.state().places.at.tolist() == [[312, 316]]


def test_odds_tell_what_is_in_play_from_what_is_not():
    frame = tracks(0, (1, 0, 312.0, 316.0, 0.0), (2, 0, 900.0, 320.0, 0.0), PERSON)

    found = play_odds(frame, BALL, no_places())

    np.testing.assert_allclose(found[:2], (IN_PLAY, SCENERY))
