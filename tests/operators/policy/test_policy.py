"""Tracks -> Scanpath: the contract of every policy, and the baselines."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.policy import (
    CentredPolicy,
    GreedyPolicy,
    LearnedPolicy,
    LearnedPolicySettings,
    PursuitPolicy,
    PursuitPolicySettings,
    RoundRobinPolicy,
    VerifyingPolicy,
)
from operators.policy.network import SHIPPED, PolicyNetwork, file_of
from pipeline import (
    GraphError,
    MessageError,
    RoiFeatures,
    Scanpath,
    SettingsError,
    WeightsError,
)
from pipeline.codec import dumps, loads
from pipeline.contract import inputs_of, outputs_of, settings_of
from pipeline.graph.plan import load_operator
from pipeline.testing import drive, header
from tests.operators.policy.made_up import tracks


def test_a_plan_is_for_the_frames_after_the_tracks():
    (path,) = drive(
        PursuitPolicy, [tracks(7, (3, 1, 500, 500, 0))], {"target": "player", "confirm": 1}
    )

    assert path.first_seq == 8
    assert path.choice.tolist() == [3] * 16
    assert path.probability.tolist() == [[1.0]] * 16


def test_centred_looks_at_the_middle_and_at_no_object():
    (path,) = drive(CentredPolicy, [tracks(0, (1, 1, 500, 500, 0))])

    assert path.choice.tolist() == [-1] * 16
    assert path.boxes[0].tolist() == [720, 405, 1200, 675]
    assert not path.probability.any()


def test_round_robin_shows_every_object_in_turn_where_it_will_be():
    world = tracks(0, (2, 1, 100, 100, 5), (5, 0, 700, 300, -10), (9, 1, 900, 800, 0))

    (path,) = drive(RoundRobinPolicy, [world], {"dwell": 3, "horizon": 10})

    assert path.choice.tolist() == [2, 2, 2, 5, 5, 5, 9, 9, 9, 2]
    np.testing.assert_allclose(path.boxes[3], [700 - 40 - 8, 292, 700 - 40 + 8, 308])


def test_round_robin_continues_while_objects_come_and_go():
    here = [(k, 1, 100.0 * k, 500, 0) for k in range(1, 6)]
    frames = [tracks(k, *(here[1:] if k == 3 else here)) for k in range(8)]

    paths = drive(RoundRobinPolicy, frames, {"dwell": 2})

    assert [int(p.choice[0]) for p in paths] == [1, 1, 2, 2, 3, 3, 4, 4]


def test_round_robin_may_be_limited_to_a_class():
    world = tracks(0, (1, 1, 100, 100, 0), (2, 0, 700, 300, 0))

    (path,) = drive(RoundRobinPolicy, [world], {"target": "ball"})

    assert set(path.choice.tolist()) == {2}


@pytest.mark.parametrize("policy", [PursuitPolicy, GreedyPolicy, RoundRobinPolicy, CentredPolicy])
def test_a_frame_without_objects_is_answered_with_places_in_the_field(policy):
    (path,) = drive(policy, [tracks(0)])

    assert path.choice.tolist() == [-1] * 16
    assert path.probability.shape == (16, 0)
    assert (path.boxes >= 0).all()
    assert (path.boxes <= [1920, 1080, 1920, 1080]).all()


def looks(seq: int, *ids: int, value: float = 1.0, width: int = 4) -> dict[str, RoiFeatures]:
    features = np.full((len(ids), width), value, np.float32)
    return {
        "features": RoiFeatures(
            header=header(seq),
            ids=np.array(ids, np.int32),
            features=features,
            genuine=np.ones(len(ids), np.float32),
        )
    }


def test_looks_are_kept_for_a_few_frames():
    subject = LearnedPolicy(LearnedPolicySettings())
    subject.open()

    for k in range(500):
        subject.on_features(**looks(k, k, k + 1, value=k))

    memory = subject.state().memory
    assert memory.ids.tolist() == [496, 497, 497, 498, 498, 499, 499, 500]
    assert memory.features[:, 0].tolist() == memory.seqs.tolist()


def test_features_that_change_their_width_are_refused():
    with pytest.raises(MessageError, match="expected 4 channels, got 3"):
        drive(LearnedPolicy, [looks(0, 1), looks(1, 1, width=3)])


@pytest.mark.parametrize("cls", [LearnedPolicy, PursuitPolicy, GreedyPolicy, RoundRobinPolicy])
def test_a_class_that_no_track_has_is_refused_while_it_runs(cls):
    kind = settings_of(cls)
    policy = cls(kind(target="ball"))
    policy.open()
    policy.on_tracks(tracks(0, (1, 0, 50, 50, 0), channels=64))

    with pytest.raises(SettingsError, match="expected one of ball, player, got refree"):
        policy.on_settings(kind(target="refree"))
    assert policy.settings.target == "ball"

    policy.on_settings(kind(target="player"))
    assert policy.settings.target == "player"


def test_a_prompt_box_may_be_set_where_the_graph_names_an_unknown_class():
    policy = PursuitPolicy(PursuitPolicySettings(target="refree"))
    policy.open()
    policy.on_tracks(tracks(0, (1, 0, 50, 50, 0)))

    policy.on_settings(PursuitPolicySettings(target="refree", prompt_box=(1.0, 2.0, 3.0, 4.0)))

    assert policy.settings.prompt_box == (1.0, 2.0, 3.0, 4.0)


@pytest.mark.parametrize("settings", [LearnedPolicySettings, PursuitPolicySettings])
def test_a_prompt_box_that_is_no_box_is_refused(settings):
    with pytest.raises(SettingsError, match="prompt_box: expected left, top, right, bottom"):
        settings(prompt_box=(10.0, 10.0, 5.0, 20.0))


ALL = [
    *(LearnedPolicy, PursuitPolicy, VerifyingPolicy),
    *(GreedyPolicy, RoundRobinPolicy, CentredPolicy),
]


@pytest.mark.parametrize("policy", ALL)
def test_the_strategy_as_a_setting_is_refused_with_the_classes_to_name(policy):
    said = (
        rf"{policy.__name__}\.strategy: expected the strategy as the class of the node, operator: "
        "operators.policy:LearnedPolicy, VerifyingPolicy, PursuitPolicy, GreedyPolicy, "
        "RoundRobinPolicy or CentredPolicy"
    )
    with pytest.raises(SettingsError, match=said):
        drive(policy, [], {"strategy": "pursue"})


@pytest.mark.parametrize(
    ("policy", "setting"),
    [
        (PursuitPolicy, {"weights": "policy.onnx"}),
        (PursuitPolicy, {"dwell": 3}),
        (LearnedPolicy, {"confirm": 3}),
        (RoundRobinPolicy, {"prompt_box": [0, 0, 9, 9]}),
        (CentredPolicy, {"target": "ball"}),
    ],
)
def test_settings_of_one_policy_are_refused_by_another(policy, setting):
    with pytest.raises(SettingsError, match="no such setting"):
        drive(policy, [], setting)


def test_the_former_class_is_refused_with_the_classes_to_name_instead():
    with pytest.raises(GraphError, match=r"there is no class Policy any more; name operators\.po"):
        load_operator("operators.policy:Policy")


def test_every_policy_can_take_the_place_of_another_in_a_graph():
    assert all(inputs_of(policy) == inputs_of(LearnedPolicy) for policy in ALL)
    assert all(outputs_of(policy) == {"out": Scanpath} for policy in ALL)


def test_a_setting_by_its_former_name_is_refused_with_the_new_one():
    with pytest.raises(SettingsError, match=r"held_by: renamed; expected carriers"):
        drive(PursuitPolicy, [], {"held_by": ["player"]})
    with pytest.raises(SettingsError, match=r"loyalty: renamed; expected target_prior"):
        drive(LearnedPolicy, [], {"loyalty": 1})
    with pytest.raises(SettingsError, match=r"least_genuine: removed; objects that the ROI"):
        drive(LearnedPolicy, [], {"least_genuine": 0.2})


object_ = st.tuples(
    st.integers(0, 1), st.floats(-50, 2000), st.floats(-50, 1100), st.floats(-30, 30)
)


AIMS = [{"target": "ball"}, {"target_id": 2}, {"prompt_box": (0, 0, 900, 900)}, {}]
PURSUITS = [(PursuitPolicy, {"confirm": 2, "patience": 2, **aim}) for aim in AIMS]
TOURS = [(cls, aim) for cls in (RoundRobinPolicy, GreedyPolicy) for aim in ({"target": "ball"}, {})]


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([*PURSUITS, *TOURS]),
    st.lists(st.lists(object_, max_size=5), min_size=2, max_size=12),
)
def test_any_tracks_give_a_complete_plan_and_a_successor_gives_the_same(policy, frames):
    cls, values = policy
    old, successor = (cls(settings_of(cls)(**values)) for _ in range(2))
    old.open()
    successor.open()

    for k, objects in enumerate(frames):
        world = tracks(3 * k, *[(i + 1, *o) for i, o in enumerate(objects)])
        successor.restore(loads(type(old.state()), dumps(old.state())))
        path = old.on_tracks(world)

        assert dumps(successor.on_tracks(world)) == dumps(path)
        assert loads(Scanpath, dumps(path)).boxes.shape == (16, 4)
        assert np.isfinite(path.boxes).all()
        assert set(path.choice.tolist()) <= {-1, *world.ids.tolist()}


def test_the_networks_that_are_shipped_are_known_by_name() -> None:
    network = PolicyNetwork(file_of("long_horizon"))

    network.suits(horizon=200, observed=10)
    assert file_of("") == SHIPPED
    assert file_of("mine/policy.onnx") == Path("mine/policy.onnx")


def test_the_long_horizon_is_refused_with_settings_of_the_usual_one() -> None:
    operator = LearnedPolicy(LearnedPolicySettings(weights="long_horizon"))

    with pytest.raises(WeightsError, match="expected horizon 16 and observed 4 as policy's"):
        operator.open()
