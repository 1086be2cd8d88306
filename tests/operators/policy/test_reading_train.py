"""Training of the policy that reads, and the network it writes as an operator."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import torch
from click.testing import CliRunner

from operators.policy import GreedyReadingPolicy, ReadingPolicy, ReadingPolicySettings
from operators.policy.model import PolicyNet
from operators.policy.model import export as export_other
from operators.policy.reading import training
from operators.policy.reading.model import INPUTS, ReadingNet, export
from operators.policy.reading.network import ReadingNetwork
from operators.policy.reading.settings import ReadingTrainSettings
from operators.policy.reading.street import Street
from operators.policy.reading.train import command
from operators.policy.reading.training import (
    Run,
    batch_of,
    loss_of,
    read_by,
    round_of,
    train,
)
from operators.policy.reading.utility import expected
from operators.training import checkpoint
from pipeline import SettingsError
from pipeline.boxes import covered
from pipeline.errors import MessageError, WeightsError
from pipeline.testing import drive
from tests.operators.policy.made_up_texts import reading, tracks
from tests.operators.policy.recorded_texts import CONTEXT, ROI, SIGNS, street

SIDES = {"roi_channels": ROI, "context_channels": CONTEXT}


def settings(tmp_path: Path, **given: object) -> ReadingTrainSettings:
    values = {
        "data": tmp_path, "out": tmp_path / "out", "iterations": 12, "batch": 8, "episodes": 4,
        "length": 8, "rate": 1e-3, "device": "cpu", "keep": 1.0, "checks": 4,
    }  # fmt: skip
    return ReadingTrainSettings(**(values | given))  # type: ignore[arg-type]


@pytest.fixture
def clips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Street]:
    """Replace the recordings of the scene, which take seconds each, by a made-up one."""
    found = [street(tmp_path)]
    monkeypatch.setattr(training, "recorded", lambda *_: (found, found))
    monkeypatch.setattr(training, "identity_of", lambda s: {"seed": str(s.seed)})
    return found


@pytest.fixture
def network(tmp_path: Path) -> Path:
    torch.manual_seed(1)
    export(ReadingNet(**SIDES), tmp_path / "reading.onnx")
    return tmp_path / "reading.onnx"


def test_a_training_records_clips_with_the_graph_that_ships(tmp_path: Path) -> None:
    found = training.identity_of(settings(tmp_path))

    assert "code of operators.association:Association" in found
    assert found != training.identity_of(settings(tmp_path, seed=2))


def test_the_loss_has_the_utility_of_a_plan() -> None:
    rng = np.random.default_rng(2)
    reads = rng.random((3, 2, 16)).astype(np.float32)
    probability = rng.dirichlet(np.ones(3), 16).T.astype(np.float32)

    left = np.array([1, 0.25], np.float32)

    found = read_by(*(torch.from_numpy(each[None]) for each in (probability, reads, left)))

    assert float(found[0]) == pytest.approx(expected(reads, left, probability), rel=1e-4)


def test_the_loss_is_lower_for_a_plan_that_reads_both_texts(tmp_path: Path) -> None:
    reads = torch.zeros(1, 2, 2, 2)
    reads[0, 0, 0], reads[0, 1, 1] = 1, 1
    given = {
        "reads": reads,
        "left": torch.ones(1, 2),
        "worth": torch.tensor([[[1.0, 0.0], [1.0, 1.0]]]),
        "mask": torch.ones(1, 2, dtype=torch.bool),
    }
    turns = torch.tensor([[[5.0, -5.0], [-5.0, 5.0]]])
    stays = torch.tensor([[[5.0, 5.0], [-5.0, -5.0]]])

    found = [loss_of(logits, given, settings(tmp_path)) for logits in (turns, stays)]

    assert found[0][0] < found[1][0]
    assert found[0][1] > 0.99 > 0.6 > found[1][1]


def test_training_increases_the_utility_and_writes_log_plot_and_weights(
    tmp_path: Path, clips: list[Street]
) -> None:
    said: list[str] = []
    given = settings(tmp_path, iterations=24)

    trained = train(given, say=said.append)
    export(trained, tmp_path / "reading.onnx")

    torch.manual_seed(given.seed)
    fresh = ReadingNet(**clips[0].recording.sides)
    samples = round_of(Run(given, fresh), clips, 0)
    batch = batch_of(samples, range(len(samples)), torch.device("cpu"))
    with torch.no_grad():
        before, after = (
            loss_of(net.eval()(*(batch[name] for name in INPUTS)), batch, given)[0]
            for net in (fresh, trained)
        )
    assert after < before - 0.1
    assert ReadingNetwork(tmp_path / "reading.onnx").roi_channels == ROI
    assert (tmp_path / "out" / "log.csv").read_text().startswith("step,elapsed_s,loss,utility\n20,")
    assert (tmp_path / "out" / "training.png").exists()
    assert '"texts": 12, "shown"' in said[-1]


@pytest.mark.usefixtures("clips")
def test_an_interrupted_training_ends_like_an_uninterrupted_one(tmp_path: Path) -> None:
    whole = train(settings(tmp_path, out=tmp_path / "whole"), say=lambda _: None)
    first, calls, advance = settings(tmp_path, out=tmp_path / "parts"), 0, training.advance

    def interrupted(*given: object) -> tuple[float, float]:
        nonlocal calls
        calls += 1
        if calls == 10:
            raise KeyboardInterrupt
        return advance(*given)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "advance", interrupted)
        patch.setattr(checkpoint, "EVERY_S", 0.0)
        with pytest.raises(KeyboardInterrupt):
            train(first, say=lambda _: None)
    resumed = train(first, say=lambda _: None)

    for name, value in whole.state_dict().items():
        assert torch.allclose(value, resumed.state_dict()[name], atol=1e-6), name


@pytest.mark.usefixtures("clips")
def test_another_training_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    train(settings(tmp_path), say=lambda _: None)

    with pytest.raises(SettingsError, match="seed: this folder's training has 1, got 9"):
        train(settings(tmp_path, seed=9), say=pytest.fail)


def test_before_training_the_network_decides_as_the_rule_does(network: Path) -> None:
    world = tracks(0, *SIGNS, channels=CONTEXT)

    learned = drive(ReadingPolicy, [world], {"weights": str(network)})[0]
    rule = drive(GreedyReadingPolicy, [world])[0]

    shown = [covered(world.predicted[:, 0], path.boxes[0]) == 1 for path in (learned, rule)]
    assert shown[0].tolist() == shown[1].tolist() == [True, False, True]


def test_without_feedback_what_was_read_changes_nothing(network: Path) -> None:
    torch.manual_seed(1)
    export(ReadingNet(**SIDES, use=("roi", "global", "motion")), network.with_name("deaf.onnx"))
    world = tracks(0, *SIGNS, channels=CONTEXT)
    percept = reading(0, world.boxes[:1, -1], 0.95)

    def told(path: Path, *heard: object) -> np.ndarray:
        following = tracks(1, *SIGNS, channels=CONTEXT)
        messages = [world, *({"percept": each} for each in heard), following]
        return np.asarray(drive(ReadingPolicy, messages, {"weights": str(path)})[-1].probability)

    deaf = network.with_name("deaf.onnx")
    np.testing.assert_array_equal(told(deaf), told(deaf, percept))
    assert not np.array_equal(told(network), told(network, percept))


def test_the_policy_plans_windows_inside_the_field_with_and_without_tracks(network: Path) -> None:
    worlds = [tracks(0, *SIGNS, channels=CONTEXT), tracks(1)]

    for path in drive(ReadingPolicy, worlds, {"weights": str(network)}):
        assert path.boxes.shape == (16, 4)
        assert np.isfinite(path.boxes).all()
        assert path.first_seq == path.header.seq + 1
        assert (path.probability.sum(1) <= 1 + 1e-5).all()


def test_a_successor_decides_as_its_predecessor_would(network: Path) -> None:
    asked = ReadingPolicySettings(weights=str(network))
    given, other = ReadingPolicy(asked), ReadingPolicy(asked)
    for subject in (given, other):
        subject.open()
    world = tracks(0, *SIGNS, channels=CONTEXT)
    given.on_tracks(world)
    given.on_percept(reading(0, world.boxes[:2, -1], 0.95, 0.95))

    other.restore(given.state())

    following = tracks(1, *SIGNS, channels=CONTEXT)
    plans = [subject.on_tracks(following) for subject in (given, other)]
    np.testing.assert_array_equal(plans[0].probability, plans[1].probability)
    np.testing.assert_array_equal(plans[0].boxes, plans[1].boxes)


def test_numbers_that_are_not_finite_leave_the_last_plan_in_effect(
    network: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world = tracks(0, *SIGNS, channels=CONTEXT)
    broken = replace(world, features=world.features * np.float32(np.nan))

    (path,) = drive(ReadingPolicy, [broken], {"weights": str(network)})

    assert not len(path.boxes)
    assert "policy.tracks: expected finite numbers in frame 0" in caplog.text


def test_tracks_of_another_detector_are_refused(network: Path) -> None:
    with pytest.raises(MessageError, match="expects 4 frames of 8 features"):
        drive(ReadingPolicy, [tracks(0, *SIGNS, channels=3)], {"weights": str(network)})


def test_the_network_of_another_policy_is_refused(tmp_path: Path) -> None:
    export_other(PolicyNet(**SIDES), tmp_path / "other.onnx")

    with pytest.raises(WeightsError, match="expected a reading policy's inputs boxes, condition"):
        ReadingNetwork(tmp_path / "other.onnx")


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--use", "roi,smell", "expected some of roi, global, motion, feedback, got smell"),
        ("--delays", "soon", "--delays: expected frames such as 1,2,4, got 'soon'"),
        ("--device", "gpu", "device: expected auto, cpu, cuda, cuda:N or mps, got gpu"),
        ("--scales", "half", "--scales: expected shares such as 1,0.5, got 'half'"),
        ("--scales", "2", "scales: expected some of .05 to 1, got (2.0,)"),
        ("--keep", "1.5", "keep: must be within 0..1, got 1.5"),
        ("--episodes", "0", "episodes: must be at least 1, got 0"),
        ("--out", __file__, "test_reading_train.py: expected a folder, got a file"),
    ],
)
def test_wrong_options_are_refused(tmp_path: Path, option: str, value: str, said: str) -> None:
    words = ["--data", str(tmp_path), "--out", str(tmp_path), option, value]

    result = CliRunner().invoke(command, words)

    assert result.exit_code == 2
    assert said in result.output
