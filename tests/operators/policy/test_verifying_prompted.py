"""Verifying: one asked for by id or box is followed as by `LearnedPolicy`, or `PursuitPolicy`."""

import numpy as np
import pytest

from operators.policy import (
    LearnedPolicy,
    LearnedPolicySettings,
    PursuitPolicy,
    VerifyingPolicy,
    VerifyingPolicySettings,
)
from operators.policy.conditioning import CHANNELS
from pipeline import RoiFeatures, Scanpath, SettingsError, Tracks, codec
from pipeline.node.operator_state import restore
from pipeline.settings import build
from pipeline.testing import drive, header
from tests.operators.policy.made_up import tracks

ASKED = {"target": "", "prompt_box": (290.0, 290.0, 310.0, 310.0)}


def looks_and_tracks(seq: int) -> tuple[RoiFeatures, Tracks]:
    """Return a ball at (300, 300), another one, a crowd, and what the ROI showed of the first."""
    crowd = [(20 + k, 1, 900.0 + 50 * k, 500.0, 0.0) for k in range(3)]
    frame = tracks(seq, (1, 0, 300, 300, 2.0), (2, 0, 1500, 800, 0.0), *crowd, channels=CHANNELS)
    features = RoiFeatures(
        header=frame.header, ids=np.array([1], np.int32), features=np.ones((1, 576), np.float32),
        genuine=np.array([0.9], np.float32),
    )  # fmt: skip
    return features, frame


def played(policy: LearnedPolicy | VerifyingPolicy, frames: range) -> list[Scanpath]:
    paths = []
    for seq in frames:
        features, frame = looks_and_tracks(seq)
        policy.on_features(features)
        paths.append(policy.on_tracks(frame))
    return paths


def verifying(**values: object) -> VerifyingPolicy:
    policy = VerifyingPolicy(build(VerifyingPolicySettings, values, "policy"))
    policy.open()
    return policy


def test_it_is_followed_as_by_the_learned_policy_also_after_a_swap() -> None:
    network = LearnedPolicy(build(LearnedPolicySettings, ASKED, "policy"))
    network.open()
    first, second = verifying(**ASKED), verifying(**ASKED)

    wanted = played(network, range(8))
    got = played(first, range(4))
    assert restore(second, codec.dumps(first.state())) == "carried over"
    got += played(second, range(4, 8))

    for mine, other in zip(got, wanted, strict=True):
        assert mine.choice[0] == 1
        np.testing.assert_array_equal(mine.choice, other.choice)
        np.testing.assert_array_equal(mine.boxes, other.boxes)
        np.testing.assert_array_equal(mine.probability, other.probability)


def crossing(seq: int, label: int = 1) -> Tracks:
    """Return a ball and two people; the first is lost from frame 6 to 9, then has another id."""
    first = [(20 if seq < 6 else 30, label, 900.0 + 4 * seq, 500.0, 4.0)]
    there = first if not 6 <= seq < 10 else []
    return tracks(seq, (1, 0, 300, 300, 0), *there, (21, 1, 980.0, 500.0, 0.0), channels=CHANNELS)


def choices(paths: list[Scanpath]) -> list[int]:
    return [int(path.choice[0]) for path in paths]


FIRST = {"prompt_box": (880.0, 480.0, 920.0, 520.0)}


@pytest.mark.parametrize("asked", [FIRST, {"target_id": 20}])
def test_a_person_is_followed_as_by_pursuit_also_after_a_swap(asked: dict[str, object]) -> None:
    frames = [crossing(seq) for seq in range(20)]
    first, second = verifying(target="", **asked), verifying(target="", **asked)

    wanted = drive(PursuitPolicy, frames, asked)
    got = [first.on_tracks(frame) for frame in frames[:8]]
    assert restore(second, codec.dumps(first.state())) == "carried over"
    got += [second.on_tracks(frame) for frame in frames[8:]]

    assert choices(got) == choices(wanted) == [20] * 6 + [-1] * 4 + [30] * 10
    for mine, other in zip(got[3:], wanted[3:], strict=True):  # the first three are the network's
        np.testing.assert_array_equal(mine.boxes, other.boxes)


def test_a_person_who_is_lost_as_soon_as_known_is_waited_for_where_that_was() -> None:
    policy = verifying(target="", **FIRST)
    for seq in range(3):
        policy.on_tracks(crossing(seq))

    path = policy.on_tracks(crossing(6))

    assert path.choice[0] == -1
    np.testing.assert_array_equal(path.boxes[0], crossing(2).boxes[1, -1])
    assert policy.on_tracks(crossing(10)).choice[0] == 30


@pytest.mark.parametrize(("first", "later", "person"), [(0, 1, True), (1, 0, False)])
def test_the_class_that_a_track_has_later_counts(first: int, later: int, person: bool) -> None:
    policy = verifying(target="", target_id=20)

    for seq in range(5):
        policy.on_tracks(crossing(seq, later if seq else first))

    assert policy.state().is_person is person


def test_a_person_who_is_misread_as_a_ball_is_carried_by_nobody_and_comes_back() -> None:
    policy = verifying(target="", target_id=20)

    got = [policy.on_tracks(crossing(seq, 0 if 3 <= seq < 6 else 1)) for seq in range(14)]

    assert choices(got) == [20] * 6 + [-1] * 4 + [30] * 4
    np.testing.assert_array_equal(got[9].boxes[0], crossing(5, 0).boxes[1, -1])


def test_without_classes_of_people_the_network_follows_everybody() -> None:
    policy = verifying(target="", target_id=20, carriers=())

    assert choices([policy.on_tracks(crossing(seq)) for seq in range(5)]) == [20] * 5
    assert not policy.state().is_person


def test_tracks_that_are_not_finite_leave_the_last_plan_in_effect(
    caplog: pytest.LogCaptureFixture,
) -> None:
    policy = verifying(target="", target_id=20)
    for seq in (*range(6), 10):
        policy.on_tracks(crossing(seq))
    broken = crossing(11)
    broken.boxes[1] = np.nan

    assert not len(policy.on_tracks(broken).choice)
    assert "expected finite numbers in frame 11" in caplog.text
    assert np.isfinite(policy.state().box).all()
    assert policy.state().is_person
    assert policy.on_tracks(crossing(12)).choice[0] == 30


def test_after_a_person_a_ball_is_followed_by_the_network_again() -> None:
    policy = verifying(target="", target_id=20)
    played(policy, range(3))
    assert policy.state().is_person

    policy.on_settings(build(VerifyingPolicySettings, ASKED, "policy"))

    assert played(policy, range(3, 6))[-1].probability.max() < 1
    assert not policy.state().is_person


def test_a_person_of_another_stream_is_another_one() -> None:
    policy = verifying(target="", target_id=20)
    played(policy, range(3))

    policy.on_stream(header(0, stream="another"))

    assert not policy.state().is_person


def test_a_box_can_be_given_to_a_policy_that_searches_and_a_class_again() -> None:
    policy = verifying(target="ball")
    (path,) = played(policy, range(1))
    assert path.choice[0] == -1  # a ball is looked at, not yet believed
    assert path.boxes[0].tolist() == [1492, 792, 1508, 808]

    policy.on_settings(build(VerifyingPolicySettings, ASKED, "policy"))
    assert played(policy, range(4, 8))[-1].choice[0] == 1

    with pytest.raises(SettingsError, match=r"expected one of ball, player, got cat"):
        policy.on_settings(build(VerifyingPolicySettings, {"target": "cat"}, "policy"))
    assert policy.settings.prompt_box == ASKED["prompt_box"]
    assert played(policy, range(8, 9))[-1].choice[0] == 1
    policy.on_settings(build(VerifyingPolicySettings, {"target": "ball"}, "policy"))
    assert played(policy, range(9, 11))[-1].choice[0] == 1  # the ROI has shown it often enough


def test_another_stream_shows_other_objects() -> None:
    policy = verifying(**ASKED)
    assert len(played(policy, range(4))) == 4
    assert len(policy.state().learned.memory.ids)

    policy.on_stream(header(0, stream="another"))

    assert not len(policy.state().learned.memory.ids)
    assert not policy.state().learned.target.placed


def test_an_unknown_class_is_logged_while_a_box_is_followed(
    caplog: pytest.LogCaptureFixture,
) -> None:
    policy = verifying(**ASKED | {"target": "cat"})

    played(policy, range(2))

    said = "policy.target: expected one of ball, player, got cat"
    assert said in [record.getMessage() for record in caplog.records]
