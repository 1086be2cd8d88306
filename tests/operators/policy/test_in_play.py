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
    Places,
    in_play,
    no_places,
    places_after,
    play_odds,
    tells,
)
from operators.policy.target import TargetSpec
from pipeline import Scanpath, Tracks, codec
from pipeline.node.operator_state import restore
from pipeline.settings import build
from pipeline.testing import drive
from tests.operators.policy.made_up import tracks

BALL = TargetSpec(label="ball")
PERSON = (9, 1, 300.0, 300.0, 0.0)  # 40 px tall
RESTS = (1, 0, 312.0, 316.0, 0.0)  # at the person's feet, 16 px wide
Row = tuple[int, int, float, float, float]


def playing(frame: Tracks, places: Places) -> bool:
    """Whether the first track of a frame is in play."""
    return bool(in_play(frame, BALL, places)[0])


@pytest.mark.parametrize(
    ("ball", "expected"),
    [
        ((1, 0, 327.0, 300.0, 0.0), True),
        ((1, 0, 329.0, 300.0, 0.0), False),
        ((1, 0, 400.0, 300.0, 2.5), True),
        ((1, 0, 400.0, 300.0, 2.3), False),
    ],
    ids=["near a person", "just not near", "alone, it rolls", "alone, it jitters"],
)
def test_a_ball_is_in_play_if_it_moves_or_a_person_is_near(ball: Row, expected: bool) -> None:
    assert playing(tracks(0, ball, PERSON), no_places()) is expected


def test_a_person_is_near_who_was_missed_in_one_frame_and_not_one_who_is_gone() -> None:
    frame = tracks(0, RESTS, PERSON, unseen=(9,))
    assert playing(frame, no_places())

    frame.visible[1] = False
    assert not playing(frame, no_places())


def rested(frames: int, *objects: Row, first: int = 0, before: Places | None = None) -> Places:
    """Return the places after so many frames with these objects."""
    places = before or no_places()
    for seq in range(first, first + frames):
        places = places_after(places, tracks(seq, *objects), BALL)
    return places


def test_a_ball_that_rests_for_long_is_scenery_until_it_moves() -> None:
    places = rested(RESTED, RESTS, PERSON)

    assert playing(tracks(RESTED - 1, RESTS, PERSON), places)
    assert not playing(tracks(RESTED, RESTS, PERSON), places)
    assert playing(tracks(RESTED, (1, 0, 312.0, 316.0, 5.0), PERSON), places)


def test_a_place_keeps_its_age_under_another_id_and_while_it_is_hidden_for_a_moment() -> None:
    places = rested(RESTED - 20, RESTS, PERSON)
    renamed = (2, 0, 314.0, 316.0, 0.0)

    places = rested(1, renamed, PERSON, first=RESTED, before=places)

    assert not playing(tracks(RESTED, renamed, PERSON), places)


def test_a_place_where_nothing_rests_is_forgotten() -> None:
    places = rested(1, RESTS)

    assert len(rested(1, PERSON, first=FORGOTTEN, before=places).at) == 1
    assert len(rested(1, PERSON, first=FORGOTTEN + 1, before=places).at) == 0


def test_what_rolls_past_makes_no_place_old() -> None:
    places = no_places()
    for seq in range(0, RESTED, 10):
        places = rested(1, (1, 0, 312.0, 316.0, 5.0), PERSON, first=seq, before=places)

    assert len(places.at) == 0


@pytest.mark.parametrize("seed", range(5))
def test_places_do_not_grow_without_limit(seed: int) -> None:
    rng, places = np.random.default_rng(seed), no_places()
    for seq in range(20):
        world = [(k, 0, *rng.uniform(0, 9000, 2), 0.0) for k in range(60)]
        places = places_after(places, tracks(seq, *world), BALL)

    assert len(places.at) == len(places.since_seq) == len(places.seen_seq) == CAPACITY
    assert places.seen_seq.max() == 19  # the newest are kept


def test_only_candidates_of_the_class_in_sight_have_places() -> None:
    frame = tracks(0, RESTS, (2, 0, 500.0, 100.0, 0.0), PERSON, unseen=(2,))

    assert places_after(no_places(), frame, BALL).at.tolist() == [[312, 316]]


def test_no_tracks_have_no_odds() -> None:
    assert play_odds(tracks(0), BALL, places_after(no_places(), tracks(0), BALL)).shape == (0,)


def test_odds_tell_what_is_in_play_from_what_is_not() -> None:
    frame = tracks(0, RESTS, (2, 0, 900.0, 316.0, 0.0), PERSON)

    np.testing.assert_allclose(play_odds(frame, BALL, no_places())[:2], (IN_PLAY, SCENERY))


@pytest.mark.parametrize(
    "spec",
    [
        TargetSpec(),
        TargetSpec(label="player"),
        TargetSpec(label="player", carriers=("robot",)),
        TargetSpec(label="ball", carriers=()),
        TargetSpec(label="ball", object_id=3),
        TargetSpec(label="ball", box=(1, 1, 9, 9)),
    ],
    ids=["any object", "people", "people, others carry", "nobody carries", "an id", "a box"],
)
def test_rest_tells_nothing_of_people_of_what_nobody_handles_and_of_one_object(
    spec: TargetSpec,
) -> None:
    assert not tells(spec)
    assert tells(BALL)


def world(seq: int) -> Tracks:
    """Return a bright spare ball that lies alone, and a faint one that a person runs with."""
    x = 300.0 + 5 * seq
    frame = tracks(seq, (1, 0, 1500.0, 800.0, 0.0), (2, 0, x, 316.0, 5.0), (9, 1, x, 300.0, 5.0))
    frame.scores[:] = (0.7, 0.3, 0.9)
    return frame


def looked_at(path: Scanpath) -> list[float]:
    """Return the middle of the window that is planned next."""
    return ((path.boxes[0, :2] + path.boxes[0, 2:]) / 2).tolist()


@pytest.mark.parametrize(("rule", "expected"), [(False, [1500, 800]), (True, [330, 316])])
def test_a_spare_ball_is_passed_over_for_one_in_play(rule: bool, expected: list[float]) -> None:
    settings = {"target": "ball", "least_probability": 0.05, "in_play": rule}

    paths = drive(PursuitPolicy, [world(k) for k in range(6)], settings)

    assert looked_at(paths[-1]) == expected


def test_the_consumer_is_told_of_one_object_that_was_asked_for_wherever_it_lies() -> None:
    box = (1492.0, 792.0, 1508.0, 808.0)
    settings = {"target": "ball", "prompt_box": box, "least_probability": 0.05, "in_play": True}
    frames = [world(k) for k in range(4)]
    for frame in frames:
        frame.scores[0] = 0.9

    assert [int(path.choice[0]) for path in drive(PursuitPolicy, frames, settings)] == [1] * 4


def asked(target: str = "ball") -> PursuitPolicySettings:
    given = {"target": target, "least_probability": 0.05, "in_play": True}
    return build(PursuitPolicySettings, given, "policy")


def opened() -> PursuitPolicy:
    policy = PursuitPolicy(asked())
    policy.open()
    return policy


def played(policy: PursuitPolicy, frames: range) -> Scanpath:
    """Play a spot beside a person, and far away a fainter ball that rolls, and return the last."""
    for seq in frames:
        frame = tracks(seq, RESTS, PERSON, (2, 0, 1500.0, 800.0, 4.0))
        frame.scores[:] = (0.7, 0.9, 0.4)
        path = policy.on_tracks(frame)
    return path


def test_a_spot_beside_a_person_is_left_in_the_end_by_a_successor_too() -> None:
    first, second = opened(), opened()
    assert looked_at(played(first, range(RESTED - 1)))[0] < 400

    assert restore(second, codec.dumps(first.state())) == "carried over"

    assert looked_at(played(second, range(RESTED - 1, RESTED + 2)))[0] > 1400


def test_another_target_has_no_places_yet() -> None:
    policy = opened()
    played(policy, range(5))
    assert len(policy.state().places.at)

    policy.on_settings(asked("player"))

    assert not len(policy.state().places.at)
