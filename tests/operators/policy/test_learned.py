"""The learned policy: the inputs of its network, and the plan made of its outputs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import torch

from operators.policy.conditioning import CHANNELS, CONDITION
from operators.policy.decision import pick, with_prior
from operators.policy.learned import LearnedPolicy, LearnedPolicySettings
from operators.policy.model import INPUTS, PolicyNet, example, export
from operators.policy.network import SHIPPED, PolicyNetwork
from operators.policy.target import TargetState
from operators.policy.tokens import MOST_OBJECTS, batched, encode_objects
from pipeline import MessageError, RoiFeatures, Scanpath, Tracks, WeightsError
from pipeline.codec import dumps, loads
from pipeline.inference import Network
from pipeline.testing import drive, header
from tests.operators.networks import mean_encoder
from tests.operators.policy.made_up import tracks

ROI = 12  # channels of the looks in these tests


def net(seed: int, **sides: Any) -> PolicyNet:
    torch.manual_seed(seed)
    return PolicyNet(**({"roi_channels": ROI} | sides)).eval()


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("policy") / "policy.onnx"
    export(net(3), path)
    return path


def world(seq: int, count: int = 6, **given: Any) -> Tracks:
    rows = [(k, k % 2, 100.0 + 300 * k, 200.0 + 100 * k, 2.0) for k in range(1, count + 1)]
    return tracks(seq, *rows, channels=CHANNELS, **given)


def inputs(count: int, seed: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return {
        name: value if value.dtype == torch.bool else torch.randn(value.shape, generator=generator)
        for name, value in example(net(1), count).items()
    }


@pytest.mark.parametrize("seed", [1, 2])
def test_the_order_of_the_objects_does_not_matter(seed: int) -> None:
    given, order = inputs(7, seed), torch.randperm(7, generator=torch.Generator().manual_seed(seed))
    turned = {n: v if n == "condition" else v[:, order] for n, v in given.items()}

    with torch.no_grad():
        straight, mixed = (net(1)(*(g[n] for n in INPUTS)) for g in (given, turned))

    assert torch.allclose(straight[:, order], mixed, atol=1e-5)
    assert not torch.allclose(straight, mixed, atol=1e-3)


def test_masked_objects_change_nothing() -> None:
    given = inputs(5, 4)
    padded = {
        n: v if n == "condition" else torch.cat([v, (9 * torch.ones_like(v[:, :3])).to(v.dtype)], 1)
        for n, v in given.items()
    }
    padded["mask"][:, 5:] = False

    with torch.no_grad():
        alone, among = (net(1)(*(g[n] for n in INPUTS)) for g in (given, padded))

    assert torch.allclose(alone, among[:, :5], atol=1e-5)
    assert (among.softmax(1)[:, 5:] == 0).all()


def test_the_condition_changes_the_choice() -> None:
    given = inputs(5, 4)
    other = given | {"condition": -given["condition"]}

    with torch.no_grad():
        assert not torch.allclose(*(net(1)(*(g[n] for n in INPUTS)) for g in (given, other)))


def test_it_has_about_as_many_parameters_as_the_network_of_the_paper() -> None:
    count = sum(p.numel() for p in PolicyNet().parameters())

    assert 0.5e6 < count < 0.62e6


@pytest.mark.parametrize("count", [1, 9, MOST_OBJECTS])
def test_onnx_runtime_computes_what_torch_computes(weights: Path, count: int) -> None:
    given = inputs(count, count)

    answer = Network(weights)({name: value.numpy() for name, value in given.items()})["logits"]

    with torch.no_grad():
        wanted = net(3)(*(given[n] for n in INPUTS))
    assert np.abs(answer - wanted.numpy()).max() < 1e-4


def test_an_ablation_ignores_the_inputs_that_it_leaves_out() -> None:
    blind, given = net(1, use=("global", "motion")), inputs(5, 2)
    other = given | {"roi": -given["roi"]}

    with torch.no_grad():
        assert torch.equal(*(blind(*(g[n] for n in INPUTS)) for g in (given, other)))


def test_moments_are_padded_to_the_longest_and_masked() -> None:
    few, many = (encode_objects(world(0, n), np.ones((n, 4, ROI), np.float32)) for n in (2, 5))

    given = batched([few, many], [np.zeros(CONDITION, np.float32)] * 2)

    assert given["mask"].tolist() == [[True, True, False, False, False], [True] * 5]
    assert given["context"].shape == (2, 5, 4, CHANNELS)
    assert given["label"][1, :, :2].tolist() == [[0, 1], [1, 0], [0, 1], [1, 0], [0, 1]]
    assert not given["boxes"][0, 2:].any()


def test_the_best_objects_are_encoded_when_there_are_too_many() -> None:
    crowd = [(k, 1, 40.0 * k, 500, 0) for k in range(1, 31)]

    kept = encode_objects(tracks(0, *crowd, channels=2), np.zeros((30, 4, ROI), np.float32))

    assert len(kept.ids) == MOST_OBJECTS


def test_a_plan_names_tracks_with_their_probabilities(weights: Path) -> None:
    (path,) = drive(LearnedPolicy, [world(3)], {"weights": str(weights)})

    assert path.first_seq == 4
    assert path.probability.shape == (16, 6)
    assert path.probability.sum(1) == pytest.approx(np.ones(16), abs=1e-5)
    chosen = path.ids[path.probability.argmax(1)]
    assert path.choice.tolist() == chosen.tolist()
    rows = np.searchsorted(path.ids, path.choice)
    assert np.array_equal(path.boxes, world(3).predicted[rows, np.arange(16)])


def test_the_rest_of_the_probability_is_that_of_the_place(weights: Path) -> None:
    values = {"weights": str(weights), "prompt_box": (1500, 900, 1520, 920)}

    (path,) = drive(LearnedPolicy, [world(0)], values)

    assert (path.probability.sum(1) < 1).all()
    places = path.boxes[path.choice == -1]
    assert np.isin(path.choice, [-1, *path.ids]).all()
    assert (places[:, 0] >= 1500).all()


def test_sampling_follows_the_probabilities_and_the_seed() -> None:
    chance = np.tile(np.array([[0.0], [0.25], [0.75]], np.float32), (1, 4000))

    drawn, again, other = (pick(chance, "sample", np.random.default_rng(s)) for s in (1, 1, 2))

    assert np.bincount(drawn, minlength=3) / 4000 == pytest.approx([0, 0.25, 0.75], abs=0.03)
    assert np.array_equal(drawn, again)
    assert not np.array_equal(drawn, other)


def test_the_target_is_kept_unless_another_object_is_much_more_probable() -> None:
    world = tracks(0, (1, 1, 100, 100, 0), (2, 1, 300, 100, 0))
    candidates, target = (
        encode_objects(world, np.zeros((2, 4, 5), np.float32)),
        TargetState(bound_id=1),
    )

    def chosen(surer: float, *, target_prior: float = 30.0) -> list[int]:
        believed = np.array([[1.0], [surer]], np.float32) / (1 + surer)
        weighed = with_prior(believed, candidates, target, target_prior)
        assert np.allclose(weighed.sum(0), 1)
        return candidates.ids[weighed.argmax(0)].tolist()

    assert [chosen(29), chosen(31), chosen(2, target_prior=1)] == [[1], [2], [2]]


def test_a_target_that_is_bound_to_no_track_changes_no_probability() -> None:
    candidates = encode_objects(tracks(0, (1, 1, 100, 100, 0)), np.zeros((1, 4, 5), np.float32))
    believed = np.ones((1, 3), np.float32)

    for target in (TargetState(), TargetState(bound_id=7)):
        assert with_prior(believed, candidates, target, 30) is believed


def look(seq: int, *ids: int, genuine: float = 1.0, channels: int = ROI) -> RoiFeatures:
    return RoiFeatures(
        header=header(seq),
        ids=np.array(ids, np.int32),
        features=np.ones((len(ids), channels), np.float32),
        genuine=np.full(len(ids), genuine, np.float32),
    )


def test_a_successor_continues_as_its_predecessor_would(weights: Path) -> None:
    values = LearnedPolicySettings(weights=str(weights), prompt_box=(390, 290, 420, 320))
    old, successor = LearnedPolicy(values), LearnedPolicy(values)
    old.open()
    successor.open()

    for k in range(6):
        old.on_features(look(k, 1, 3))
        successor.restore(loads(type(old.state()), dumps(old.state())))
        unseen = (1,) if k > 2 else ()
        path = old.on_tracks(world(k, unseen=unseen))
        assert dumps(successor.on_tracks(world(k, unseen=unseen))) == dumps(path)
        assert loads(Scanpath, dumps(path)).boxes.shape == (16, 4)


def test_another_target_takes_effect_with_the_next_plan(weights: Path) -> None:
    subject = LearnedPolicy(LearnedPolicySettings(weights=str(weights), target_id=1))
    subject.open()
    subject.on_tracks(world(0))
    assert subject.state().target.bound_id == 1

    subject.on_settings(LearnedPolicySettings(weights=str(weights), target_id=4))

    subject.on_tracks(world(1))
    assert subject.state().target.bound_id == 4


def test_changes_of_other_settings_keep_the_target(weights: Path) -> None:
    settings = LearnedPolicySettings(weights=str(weights), prompt_box=(390, 290, 420, 320))
    subject = LearnedPolicy(settings)
    subject.open()
    subject.on_tracks(world(0))
    target = subject.state().target

    subject.on_settings(replace(settings, target_prior=5.0))

    assert target.bound_id == 1
    assert subject.state().target is target


def test_without_candidates_the_plan_stays_where_the_target_was(weights: Path) -> None:
    values = {"weights": str(weights), "place_patience": 1}
    prompted = values | {"prompt_box": (100, 100, 120, 120)}

    empty = [world(k, 0) for k in range(4)]

    assert drive(LearnedPolicy, empty, prompted)[-1].boxes[0].tolist() == [100, 100, 120, 120]
    assert drive(LearnedPolicy, empty, values)[-1].choice.tolist() == [-1] * 16


def test_a_ball_that_is_out_of_sight_is_looked_for_where_most_people_are(weights: Path) -> None:
    crowd = [(k, 1, 1500.0 + 20 * k, 800.0, 0.0) for k in range(2, 6)]
    alone = (7, 1, 200.0, 200.0, 0.0)
    ball = (8, 0, 300.0, 300.0, 0.0)
    seen = [tracks(k, *crowd, alone, ball, channels=CHANNELS) for k in range(3)]
    gone = [tracks(k, *crowd, alone, channels=CHANNELS) for k in range(3, 90)]

    paths = drive(LearnedPolicy, [*seen, *gone], {"weights": str(weights), "target": "ball"})

    among = [1480 < (p.boxes[0, 0] + p.boxes[0, 2]) / 2 < 1620 and p.choice[0] == -1 for p in paths]
    assert all(among[-10:])
    assert not any(among[:3])  # while there is a ball, the network chooses
    assert not all(among[:60])


@pytest.mark.parametrize("field", ["features", "boxes", "predicted"])
def test_tracks_that_are_not_finite_leave_the_last_plan_in_force_and_are_logged_once(
    weights: Path, field: str, caplog: pytest.LogCaptureFixture
) -> None:
    frames = [world(k) for k in range(4)]
    for bad in frames[1:3]:
        getattr(bad, field)[2, 1, 0] = np.nan

    paths = drive(LearnedPolicy, frames, {"weights": str(weights)})

    assert [len(path.choice) for path in paths] == [16, 0, 0, 16]
    assert caplog.messages == ["policy.tracks: expected finite numbers in frame 1, got others"]


def test_looks_that_are_not_finite_are_discarded_and_logged_once(
    weights: Path, caplog: pytest.LogCaptureFixture
) -> None:
    subject = LearnedPolicy(LearnedPolicySettings(weights=str(weights)))
    subject.open()
    for seq in (0, 1):
        bad = look(seq, 1, 2)
        bad.features[1, 3] = np.inf
        subject.on_features(bad)

    assert not len(subject.state().memory.ids)
    assert len(subject.on_tracks(world(1)).choice) == 16
    assert caplog.messages == ["policy.features: expected finite numbers in frame 0, got others"]


def test_a_prompt_without_a_matching_track_is_logged_once(
    weights: Path, caplog: pytest.LogCaptureFixture
) -> None:
    values = {"weights": str(weights), "target_id": 77}

    drive(LearnedPolicy, [world(k) for k in range(20)], values)

    assert caplog.messages == [
        "policy.target_id: expected a track 77, none was there in frames 0 to 8"
    ]


def test_tracks_of_other_sizes_than_the_network_expects_are_refused(weights: Path) -> None:
    subject = LearnedPolicy(LearnedPolicySettings(weights=str(weights)))
    subject.open()

    with pytest.raises(MessageError, match="expects 4 frames of 64 features and 16 foreseen, got"):
        subject.on_tracks(tracks(0, (1, 0, 100, 100, 0), channels=32))
    subject.on_features(look(0, 1, channels=5))
    with pytest.raises(MessageError, match="expected 12 channels, got 5"):
        subject.on_tracks(world(1))


def test_weights_that_are_no_policy_are_refused(tmp_path: Path) -> None:
    mean_encoder(tmp_path / "other.onnx", batch="n", side_px=8, as_map=False)

    with pytest.raises(WeightsError, match=r"other\.onnx: expected a policy's inputs"):
        PolicyNetwork(tmp_path / "other.onnx")
    with pytest.raises(WeightsError, match=r"none\.onnx: no such weights"):
        PolicyNetwork(tmp_path / "none.onnx")


def test_weights_for_another_history_or_horizon_are_refused_before_the_first_frame(
    weights: Path, tmp_path: Path
) -> None:
    export(net(3, horizon=8, observed=2), tmp_path / "short.onnx")

    for path, settings in ((tmp_path / "short.onnx", {}), (weights, {"horizon": 8})):
        with pytest.raises(
            WeightsError, match=rf"{path.name}: expected horizon \d+ and observed 4"
        ):
            drive(LearnedPolicy, [], {"weights": str(path), **settings})


def test_missing_shipped_weights_are_named() -> None:
    if SHIPPED.exists():
        pytest.skip("there are shipped weights")
    with pytest.raises(WeightsError, match=r"policy\.weights: policy\.onnx is not there"):
        drive(LearnedPolicy, [])
