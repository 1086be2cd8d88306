"""Conditioning: how the target is encoded for the network."""

import re

import numpy as np
import pytest

from operators.policy.conditioning import CHANNELS, CONDITION, encode_condition, encode_place, unmet
from operators.policy.gaze_plan import PLACE
from operators.policy.target import Choice, TargetSpec, TargetState, follow
from tests.operators.policy.made_up import followed, tracks

BALL = TargetSpec(box=(92, 92, 108, 108))
LOOKS = np.full((4, 5), 7, np.float32)
CROWD = [(k, 1, 300.0 + 100 * k, 500.0, 3.0) for k in (2, 3, 4, 5)]


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        (
            TargetSpec(object_id=9),
            "policy.target_id: expected a track 9, none was there in frames 0 to 8",
        ),
        (BALL, r"policy.prompt_box: expected a track at \(92, .*, none was there in frames 0 to 8"),
    ],
)
def test_a_prompt_without_a_matching_track_is_reported_after_some_frames(
    spec: TargetSpec, said: str
) -> None:
    frames = [tracks(k, *CROWD) for k in range(9)]

    assert re.fullmatch(said, unmet(followed(spec, *frames), spec, frames[8]))
    assert not unmet(followed(spec, *frames[:3]), spec, frames[2])


def test_a_class_that_the_detector_does_not_know_is_reported() -> None:
    world = tracks(0, *CROWD)

    said = "policy.target: expected one of ball, player, got dog"
    assert unmet(TargetState(), TargetSpec(label="dog"), world) == said
    assert not unmet(TargetState(), TargetSpec(label="ball"), world)


def test_the_condition_encodes_features_place_class_and_which_of_them_are_known() -> None:
    world = tracks(0, (1, 0, 960, 540, 0), channels=CHANNELS)
    spec = TargetSpec(box=(952, 532, 968, 548))

    condition = encode_condition(followed(spec, world), spec, world)

    assert condition.shape == (CONDITION,)
    assert condition[:CHANNELS].tolist() == [1.0] * CHANNELS
    assert condition[CHANNELS : CHANNELS + 2] == pytest.approx([0, 0])
    assert condition[CHANNELS + 4 : CHANNELS + 6].tolist() == [1, 0]  # a ball, no player
    assert condition[-4:].tolist() == [1, 0, 1, 0]


def test_the_place_is_a_candidate_for_some_frames_after_the_target_is_lost() -> None:
    here, crowd = tracks(0, (1, 0, 100, 100, 0), *CROWD), [tracks(k, *CROWD) for k in range(9)]
    seen = followed(BALL, here)
    lost = follow(seen, BALL, crowd[1], Choice())

    assert encode_place(seen, BALL, here, LOOKS, patience=3) is None
    spot = encode_place(lost, BALL, crowd[1], LOOKS, patience=3)
    assert spot is not None
    assert spot.label[0, :2].tolist() == [1, 0]
    assert np.array_equal(spot.roi, LOOKS[None])
    assert spot.ids.tolist() == [PLACE]
    assert spot.path[0, :2].tolist() == [[98, 92, 114, 108], [101, 92, 117, 108]]
    assert encode_place(lost, BALL, crowd[5], LOOKS, patience=3) is None


def test_a_class_has_a_place_once_one_of_it_was_seen() -> None:
    spec, sure = TargetSpec(label="ball"), Choice(object_id=1, probability=0.9)
    here, gone = tracks(0, (1, 0, 100, 100, 0)), tracks(1, *CROWD)
    seen = follow(TargetState(), spec, here, sure)

    assert (
        encode_place(follow(TargetState(), spec, gone, sure), spec, gone, LOOKS, patience=3) is None
    )
    assert encode_place(follow(seen, spec, gone, sure), spec, gone, LOOKS, patience=3) is not None


def test_without_a_prompt_there_is_no_place_and_no_condition() -> None:
    world = tracks(0, *CROWD)

    assert (
        encode_place(followed(TargetSpec(), world), TargetSpec(), world, LOOKS, patience=3) is None
    )
    assert not np.any(encode_condition(TargetState(), TargetSpec(), world))
