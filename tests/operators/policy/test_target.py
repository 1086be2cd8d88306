"""A target: the track that it is bound to, and where it is believed to be."""

from dataclasses import dataclass
from typing import Any

import pytest

from operators.association import AssociationSettings
from operators.policy import LearnedPolicy, PursuitPolicy, RoundRobinPolicy, VerifyingPolicy
from operators.policy.motion import camera_motion
from operators.policy.target import Choice, TargetSpec, TargetState, follow, unknown_label
from pipeline import Operator, SettingsError, WeightsError
from pipeline.contract import BEFORE, settings_of
from tests.operators.policy.made_up import followed, tracks

BALL = TargetSpec(box=(92, 92, 108, 108))
CROWD = [(k, 1, 300.0 + 100 * k, 500.0, 3.0) for k in (2, 3, 4, 5)]


def test_a_box_binds_to_the_track_it_overlaps_and_moves_with_it() -> None:
    target = followed(BALL, *(tracks(k, (1, 0, 100 + 4 * k, 100, 4), *CROWD) for k in range(5)))

    assert (target.bound_id, target.label, target.seen_seq) == (1, "ball", 4)
    assert target.box.tolist() == [108, 92, 124, 108]


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
    assert followed(TargetSpec(box=(92, 92, 106, 106)), tracks(0, track)).bound_id == bound


def test_without_a_track_the_place_moves_with_the_camera() -> None:
    target = followed(BALL, *(tracks(k, *CROWD) for k in range(3)))

    assert camera_motion(tracks(0, *CROWD)).tolist() == [3, 0]
    assert target.box.tolist() == [98, 92, 114, 108]
    assert target.seen_seq == 0


def test_the_place_moves_for_every_frame_that_was_left_out() -> None:
    target = followed(BALL, *(tracks(k, *CROWD) for k in (0, 1, 4)))

    assert target.box.tolist() == [104, 92, 120, 108]


def test_a_lost_target_is_bound_again_to_a_sure_choice_near_by_of_its_class() -> None:
    bound = tracks(0, (1, 0, 100, 100, 0))
    again = tracks(1, (8, 0, 130, 100, 0), (9, 1, 100, 100, 0), (10, 0, 900, 100, 0))

    def bound_to(object_id: int, probability: float) -> int:
        target = followed(BALL, bound)
        choice = Choice(object_id=object_id, probability=probability)
        return follow(target, BALL, again, choice).bound_id

    assert bound_to(8, 0.9) == 8
    assert bound_to(8, 0.3) == 1  # not sure
    assert bound_to(9, 0.9) == 1  # another class
    assert bound_to(10, 0.9) == 1  # too far


def test_a_box_that_was_never_bound_is_not_bound_to_a_choice_of_another_size() -> None:
    world = tracks(1, (8, 0, 150, 100, 0), (9, 1, 150, 100, 0))

    def bound_to(object_id: int) -> int:
        target = followed(BALL, tracks(0, *CROWD))
        return follow(target, BALL, world, Choice(object_id=object_id, probability=0.9)).bound_id

    assert bound_to(9) == -1
    assert bound_to(8) == 8


def test_a_class_binds_to_the_object_of_it_that_the_policy_is_sure_of() -> None:
    world = tracks(1, (1, 0, 100, 100, 0), (2, 1, 500, 100, 0), (3, 0, 900, 100, 0))
    spec = TargetSpec(label="ball")

    first = follow(TargetState(), spec, world, Choice(object_id=3, probability=0.8))
    other = follow(first, spec, world, Choice(object_id=1, probability=0.8))

    assert (first.bound_id, other.bound_id) == (3, 1)
    assert follow(TargetState(), spec, world, Choice(object_id=2, probability=0.8)).bound_id == -1


def test_an_id_binds_to_the_track_with_that_id() -> None:
    world = tracks(0, (1, 0, 100, 100, 0), (2, 1, 500, 100, 0))

    assert followed(TargetSpec(object_id=2), world).bound_id == 2
    assert followed(TargetSpec(object_id=5), world).bound_id == -1


def test_an_id_has_priority_over_a_box_and_without_its_track_nothing_is_bound() -> None:
    world = tracks(0, (1, 0, 100, 100, 0), (2, 1, 500, 100, 0))
    spec = TargetSpec(object_id=5, box=BALL.box)

    target = followed(spec, world, world, chosen=Choice(object_id=1, probability=0.9))

    assert target.bound_id == -1
    assert not target.placed


@dataclass(frozen=True)
class Known:
    """Settings of a detector, as far as policies ask for them."""

    reported_classes: tuple[str, ...] = ("person", "dog", "sports ball")
    feature_channels: int = 64


class Absent:
    """Settings of a detector whose weights are not there."""

    @property
    def reported_classes(self) -> tuple[str, ...]:
        raise WeightsError("not pulled")

    feature_channels = reported_classes


POLICIES = [LearnedPolicy, PursuitPolicy, RoundRobinPolicy, VerifyingPolicy]


def advised(policy: type[Operator[Any, Any]], target: str, *before: object) -> list[str]:
    return list(policy.advise(settings_of(policy)(target=target), {BEFORE: before}))


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize(
    ("target", "hint"),
    [("dgo", ", did you mean 'dog'?"), ("Ball", ", did you mean 'sports ball'?"), ("zebra", "")],
)
def test_a_class_that_the_detector_does_not_know_is_refused_before_the_start(
    policy: type[Operator[Any, Any]], target: str, hint: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        advised(policy, target, object(), Known(), Known(reported_classes=("zebra", "Ball", "dgo")))

    said = f"target: expected one of person, dog, sports ball, got {target}{hint}"
    assert str(caught.value) == said


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("before", [(), (object(),), (Known(),), (Absent(), Known(("cup",)))])
def test_a_class_that_nothing_contradicts_is_taken(
    policy: type[Operator[Any, Any]], before: tuple[object, ...]
) -> None:
    assert advised(policy, "dog", *before) == []


def test_many_classes_are_named_in_part() -> None:
    names = [f"class {number}" for number in range(1203)]

    said = unknown_label("x" * 1000, names)

    assert "class 99 … (1103 more), got xxx" in said
    assert len(said) < 1200


@pytest.mark.parametrize("policy", [LearnedPolicy, VerifyingPolicy])
@pytest.mark.parametrize("channels", [0, 32])
def test_a_detector_whose_features_the_network_does_not_know_is_refused(
    policy: type[Operator[Any, Any]], channels: int
) -> None:
    with pytest.raises(SettingsError, match=f"reads 64 features .* got one with {channels}; "):
        advised(policy, "dog", Known(feature_channels=channels))
    assert advised(PursuitPolicy, "dog", Known(feature_channels=channels)) == []


@pytest.mark.parametrize("policy", [LearnedPolicy, VerifyingPolicy])
@pytest.mark.parametrize(
    ("tracks_of", "said"),
    [
        (AssociationSettings(horizon=8), "expects tracks of horizon 16, got 8"),
        (AssociationSettings(observed=2), "expects tracks of observed 4, got 2"),
    ],
)
def test_tracks_of_another_length_are_refused_before_the_start(
    policy: type[Operator[Any, Any]], tracks_of: AssociationSettings, said: str
) -> None:
    with pytest.raises(SettingsError, match=said):
        advised(policy, "dog", Known(), tracks_of)
    assert advised(policy, "dog", Known(), AssociationSettings()) == []
