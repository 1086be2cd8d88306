"""Conditioning: who is meant, and where they are believed to be."""

import re

import numpy as np
import pytest

from operators.policy.conditioning import (
    CHANNELS,
    CONDITION,
    Choice,
    Prompt,
    Wish,
    camera_motion,
    condition,
    follow,
    place,
    unmet,
)
from operators.policy.plan import PLACE
from pipeline import Tracks
from tests.operators.policy.made_up import tracks

BALL = Wish(box=(92, 92, 108, 108))
LOOKS = np.full((4, 5), 7, np.float32)
CROWD = [(k, 1, 300.0 + 100 * k, 500.0, 3.0) for k in (2, 3, 4, 5)]


def followed(wish: Wish, *frames: Tracks, chosen: Choice | None = None) -> Prompt:
    prompt = Prompt()
    for world in frames:
        prompt = follow(prompt, wish, world, chosen or Choice())
    return prompt


def test_a_box_binds_to_the_track_it_overlaps_and_goes_with_it() -> None:
    prompt = followed(BALL, *(tracks(k, (1, 0, 100 + 4 * k, 100, 4), *CROWD) for k in range(5)))

    assert (prompt.bound_id, prompt.label, prompt.seen_seq) == (1, "ball", 4)
    assert prompt.box.tolist() == [108, 92, 124, 108]


def test_a_box_binds_late_when_its_object_is_found_late() -> None:
    unseen = [tracks(k, *CROWD[:2]) for k in range(3)]

    assert followed(BALL, *unseen).bound_id == -1
    assert followed(BALL, *unseen, tracks(3, (7, 0, 100, 100, 0))).bound_id == 7


@pytest.mark.parametrize(
    ("track", "bound"),
    [((7, 0, 112, 100, 0), 7), ((7, 0, 120, 100, 0), -1), ((7, 1, 125, 100, 0), -1)],
    ids=["near", "too far", "near and too large"],
)
def test_a_box_that_overlaps_nothing_binds_to_what_is_near_and_alike(
    track: tuple[int, int, float, float, float], bound: int
) -> None:
    assert followed(Wish(box=(92, 92, 106, 106)), tracks(0, track)).bound_id == bound


def test_without_a_track_the_place_moves_with_the_camera() -> None:
    prompt = followed(BALL, *(tracks(k, *CROWD) for k in range(3)))

    assert camera_motion(tracks(0, *CROWD)).tolist() == [3, 0]
    assert prompt.box.tolist() == [98, 92, 114, 108]
    assert prompt.seen_seq == 0


def test_the_place_moves_for_every_frame_that_was_left_out() -> None:
    prompt = followed(BALL, *(tracks(k, *CROWD) for k in (0, 1, 4)))

    assert prompt.box.tolist() == [104, 92, 120, 108]


def test_a_lost_target_is_bound_again_to_a_sure_choice_near_by_of_its_class() -> None:
    bound = tracks(0, (1, 0, 100, 100, 0))
    again = tracks(1, (8, 0, 130, 100, 0), (9, 1, 100, 100, 0), (10, 0, 900, 100, 0))

    def bound_to(object_id: int, probability: float) -> int:
        prompt = followed(BALL, bound)
        choice = Choice(object_id=object_id, probability=probability)
        return follow(prompt, BALL, again, choice).bound_id

    assert bound_to(8, 0.9) == 8
    assert bound_to(8, 0.3) == 1  # not sure
    assert bound_to(9, 0.9) == 1  # another class
    assert bound_to(10, 0.9) == 1  # too far


def test_a_box_that_was_never_bound_is_not_bound_to_a_choice_of_another_size() -> None:
    world = tracks(1, (8, 0, 150, 100, 0), (9, 1, 150, 100, 0))

    def bound_to(object_id: int) -> int:
        prompt = followed(BALL, tracks(0, *CROWD))
        return follow(prompt, BALL, world, Choice(object_id=object_id, probability=0.9)).bound_id

    assert bound_to(9) == -1
    assert bound_to(8) == 8


def test_a_class_is_whoever_of_it_the_policy_is_sure_of() -> None:
    world = tracks(1, (1, 0, 100, 100, 0), (2, 1, 500, 100, 0), (3, 0, 900, 100, 0))
    wish = Wish(target="ball")

    first = follow(Prompt(), wish, world, Choice(object_id=3, probability=0.8))
    other = follow(first, wish, world, Choice(object_id=1, probability=0.8))

    assert (first.bound_id, other.bound_id) == (3, 1)
    assert follow(Prompt(), wish, world, Choice(object_id=2, probability=0.8)).bound_id == -1


def test_an_id_is_that_track() -> None:
    world = tracks(0, (1, 0, 100, 100, 0), (2, 1, 500, 100, 0))

    assert followed(Wish(object_id=2), world).bound_id == 2
    assert followed(Wish(object_id=5), world).bound_id == -1


def test_an_id_goes_before_a_box_and_without_its_track_nothing_else_is_taken_for_it() -> None:
    world = tracks(0, (1, 0, 100, 100, 0), (2, 1, 500, 100, 0))
    wish = Wish(object_id=5, box=BALL.box)

    prompt = followed(wish, world, world, chosen=Choice(object_id=1, probability=0.9))

    assert prompt.bound_id == -1
    assert not prompt.placed


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        (
            Wish(object_id=9),
            "policy.target_id: expected a track 9, none was there in frames 0 to 8",
        ),
        (BALL, r"policy.prompt_box: expected a track at \(92, .*, none was there in frames 0 to 8"),
    ],
)
def test_a_prompt_that_nothing_answers_to_is_worth_a_word_after_some_frames(
    wish: Wish, said: str
) -> None:
    frames = [tracks(k, *CROWD) for k in range(9)]

    assert re.fullmatch(said, unmet(followed(wish, *frames), wish, frames[8]))
    assert not unmet(followed(wish, *frames[:3]), wish, frames[2])


def test_a_class_that_the_detector_does_not_know_is_worth_a_word() -> None:
    world = tracks(0, *CROWD)

    said = "policy.target: expected one of ball, player, got dog"
    assert unmet(Prompt(), Wish(target="dog"), world) == said
    assert not unmet(Prompt(), Wish(target="ball"), world)


def test_the_condition_tells_features_place_class_and_what_is_known() -> None:
    world = tracks(0, (1, 0, 960, 540, 0), channels=CHANNELS)
    wish = Wish(box=(952, 532, 968, 548))

    told = condition(followed(wish, world), wish, world)

    assert told.shape == (CONDITION,)
    assert told[:CHANNELS].tolist() == [1.0] * CHANNELS
    assert told[CHANNELS : CHANNELS + 2] == pytest.approx([0, 0])
    assert told[CHANNELS + 4 : CHANNELS + 6].tolist() == [1, 0]  # a ball, no player
    assert told[-4:].tolist() == [1, 0, 1, 0]


def test_the_place_is_offered_while_the_target_is_not_in_view_and_not_for_ever() -> None:
    here, crowd = tracks(0, (1, 0, 100, 100, 0), *CROWD), [tracks(k, *CROWD) for k in range(9)]
    seen = followed(BALL, here)
    lost = follow(seen, BALL, crowd[1], Choice())

    assert place(seen, BALL, here, LOOKS, patience=3) is None
    spot = place(lost, BALL, crowd[1], LOOKS, patience=3)
    assert spot is not None
    assert spot.label[0, :2].tolist() == [1, 0]
    assert np.array_equal(spot.roi, LOOKS[None])
    assert spot.ids.tolist() == [PLACE]
    assert spot.path[0, :2].tolist() == [[98, 92, 114, 108], [101, 92, 117, 108]]
    assert place(lost, BALL, crowd[5], LOOKS, patience=3) is None


def test_a_class_has_a_place_once_one_of_it_was_seen() -> None:
    wish, sure = Wish(target="ball"), Choice(object_id=1, probability=0.9)
    here, gone = tracks(0, (1, 0, 100, 100, 0)), tracks(1, *CROWD)
    seen = follow(Prompt(), wish, here, sure)

    assert place(follow(Prompt(), wish, gone, sure), wish, gone, LOOKS, patience=3) is None
    assert place(follow(seen, wish, gone, sure), wish, gone, LOOKS, patience=3) is not None


def test_no_prompt_no_place() -> None:
    world = tracks(0, *CROWD)

    assert place(followed(Wish(), world), Wish(), world, LOOKS, patience=3) is None
    assert not np.any(condition(Prompt(), Wish(), world))


def test_who_stands_where_a_track_ended_is_who_it_was() -> None:
    bound = [tracks(k, (1, 1, 100, 100, 0), *CROWD) for k in range(2)]
    wish = Wish(box=(80, 80, 120, 120))

    def bound_to(*here: tuple[int, int, float, float, float], unseen: tuple[int, ...] = ()) -> int:
        return followed(wish, *bound, tracks(2, *here, *CROWD, unseen=unseen)).bound_id

    assert bound_to((8, 1, 110, 100, 0)) == 8
    assert bound_to((1, 1, 100, 100, 0), (8, 1, 100, 100, 0)) == 1  # it has not ended
    assert bound_to((8, 1, 135, 100, 0)) == 1  # too far
    assert bound_to((8, 0, 100, 100, 0)) == 1  # another class
    assert bound_to((8, 1, 110, 100, 0), unseen=(8,)) == 1  # only foreseen
