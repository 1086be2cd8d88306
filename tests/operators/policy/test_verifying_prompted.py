"""Verifying: a target asked for by id or box is followed by the network, as by `LearnedPolicy`."""

import numpy as np
import pytest

from operators.policy import (
    LearnedPolicy,
    LearnedPolicySettings,
    VerifyingPolicy,
    VerifyingPolicySettings,
)
from operators.policy.conditioning import CHANNELS
from pipeline import RoiFeatures, Scanpath, SettingsError, Tracks, codec
from pipeline.node.operator_state import restore
from pipeline.settings import build
from pipeline.testing import header
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
