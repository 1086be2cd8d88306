"""Training: the loss falls, masked entries do not count, and a stopped training resumes."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import torch
from click.testing import CliRunner

from operators.policy import pool
from operators.policy import training_run as training
from operators.policy.data import Recording
from operators.policy.model import PolicyNet, export
from operators.policy.network import PolicyNetwork
from operators.policy.rollout import Late
from operators.policy.train import TrainSettings, command
from operators.policy.training_run import Clips, Run, advance, loss_of, round_of, train
from operators.training import checkpoint
from pipeline import SettingsError
from pipeline.errors import RunError
from tests.operators.policy.test_rollout import ROI, recording
from tests.operators.training.elsewhere import PLACE, pretended


def settings(tmp_path: Path, **given: object) -> TrainSettings:
    values = {
        "data": tmp_path,
        "out": tmp_path / "out",
        "iterations": 12,
        "batch": 16,
        "episodes": 6,
        "length": 8,
        "threads": 1,
        "rate": 1e-3,
        "device": "cpu",
    }
    return TrainSettings(**(values | given))  # type: ignore[arg-type]


@pytest.fixture
def clips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Recording]:
    """Replace the recordings of the scene, which take seconds each, by made-up ones."""
    found = [recording(tmp_path)]

    def recorded(given: TrainSettings, _: object) -> tuple[Clips, Clips]:
        rules = training.Rules(roi_channels=ROI)
        both = Clips(recordings=found, rules=rules, settings=given)
        return both, both

    monkeypatch.setattr(training, "recorded", recorded)
    return found


def test_the_loss_is_lower_for_the_object_that_is_worth_more() -> None:
    worth = torch.tensor([[[1.0], [0.0], [0.0]]])
    mask = torch.ones(1, 3, dtype=torch.bool)
    given = settings(Path())

    right, wrong = (
        loss_of(torch.tensor([[[a], [b], [0.0]]]), worth, mask, given) for a, b in ((4, 0), (0, 4))
    )

    assert right[0] < wrong[0]
    assert right[1] > 0.9
    assert wrong[1] < 0.05


def test_steps_without_any_gain_have_no_gradient() -> None:
    logits = torch.randn(2, 3, 5, generator=torch.Generator().manual_seed(1), requires_grad=True)
    worth = torch.zeros(2, 3, 5)
    worth[0, 1, 2] = 1

    loss_of(logits, worth, torch.ones(2, 3, dtype=torch.bool), settings(Path()))[0].backward()

    assert logits.grad is not None
    assert logits.grad[0, :, 2].abs().sum() > 0
    logits.grad[0, :, 2] = 0
    assert not logits.grad.any()


@pytest.mark.usefixtures("clips")
def test_training_increases_the_utility_and_writes_log_plot_and_weights(tmp_path: Path) -> None:
    said: list[str] = []

    net = train(settings(tmp_path, iterations=60), say=said.append)
    export(net, tmp_path / "policy.onnx")

    rows = np.loadtxt(tmp_path / "out" / "log.csv", delimiter=",", skiprows=1)
    assert rows[-1, 3] > rows[0, 3]  # expected utility
    assert PolicyNetwork(tmp_path / "policy.onnx").roi_channels == ROI
    assert (tmp_path / "out" / "training.png").exists()
    assert "coverage" in said[-1]


@pytest.mark.usefixtures("clips")
def test_a_training_that_is_killed_at_the_end_of_a_round_begins_the_next_one_alike(
    tmp_path: Path,
) -> None:
    given = settings(tmp_path, iterations=24)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checkpoint, "EVERY_S", 0.0)
        patch.setattr(training.Run, "hand_over", killed_in_training)
        with pytest.raises(KeyboardInterrupt):
            train(given, say=lambda _: None)

    state = checkpoint.read(checkpoint.path_in(given.out))
    assert state["step"] == 24 // training.ROUNDS - 1  # the round is not over with its last step


def killed_in_training(run: Run) -> None:
    if hasattr(run, "step"):  # not while it begins
        raise KeyboardInterrupt


@pytest.mark.usefixtures("clips")
def test_an_interrupted_training_ends_like_an_uninterrupted_one(tmp_path: Path) -> None:
    whole = train(settings(tmp_path, out=tmp_path / "whole", iterations=24), say=lambda _: None)
    first = settings(tmp_path, out=tmp_path / "parts", iterations=24)
    calls = 0
    advance = training.advance

    def interrupted(*given: object) -> tuple[float, float]:
        nonlocal calls
        calls += 1
        if calls == 22:
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
    header, *lines = (tmp_path / "parts" / "log.csv").read_text().splitlines()
    assert header == "step,elapsed_s,loss,utility"
    assert [line.partition(",")[0] for line in lines] == ["20"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"use": ("roi", "motion")}, "use: this folder's training has ["),
        ({"iterations": 5}, "iterations: this folder's training has 12, got 5; use another --out"),
        ({"seed": 9}, "seed: this folder's training has 1, got 9; use another --out"),
        ({"late": Late(delays=(3,))}, "delays: this folder's training has [1, 2, 4], got [3]"),
        ({"changes": ("association.iou_gate=0.2",)}, "association.iou_gate: this folder's"),
    ],
)
def test_another_training_in_the_same_folder_is_refused_before_it_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: dict[str, object], said: str
) -> None:
    Run(settings(tmp_path, out=tmp_path), PolicyNet(roi_channels=ROI)).save()

    monkeypatch.setattr(training, "recorded", pytest.fail)
    with pytest.raises(SettingsError) as refused:
        train(settings(tmp_path, out=tmp_path, **given), say=pytest.fail)

    assert str(refused.value).startswith(said)


@pytest.mark.usefixtures("clips")
def test_data_folder_threads_and_device_may_change_on_resuming(tmp_path: Path) -> None:
    Run(settings(tmp_path, out=tmp_path), PolicyNet(roi_channels=ROI)).save()
    given = settings(tmp_path / "moved", out=tmp_path, threads=2, device="auto")

    Run(given, PolicyNet(roi_channels=ROI)).resume()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        *(({n: 0}, f"{n}: must be at least 1, got 0") for n in ("clips", "validation", "batch")),
        *(({n: 0}, f"{n}: must be at least 1") for n in ("episodes", "iterations", "threads")),
        *(({n: 1}, f"{n}: must be at least 2, got 1") for n in ("frames", "length")),
        *(({"rate": rate}, "rate: must be above 0, got") for rate in (0.0, -1.0, math.nan)),
        ({"rate": math.inf}, "rate: must be above 0, got inf"),
        ({"temperature": 0.0}, "temperature: must be above 0, got 0"),
        ({"seed": -1}, "seed: must be at least 0, got -1"),
        ({"warmup": -0.1}, "warmup: must be at least 0, got -0.1"),
        ({"warmup": 1.5}, "warmup: must be within 0..1, got 1.5"),
    ],
)
def test_settings_out_of_range_are_refused(
    tmp_path: Path, given: dict[str, object], said: str
) -> None:
    with pytest.raises(SettingsError, match=said):
        settings(tmp_path, **given)


@pytest.mark.parametrize(
    "given", [{"delays": ()}, {"delays": (-1,)}, {"replans": ()}, {"replans": (4, 0)}]
)
def test_delays_and_intervals_that_are_empty_or_too_short_are_refused(
    given: dict[str, tuple[int, ...]],
) -> None:
    with pytest.raises(SettingsError, match=r"expected frames from [01] on, got"):
        Late(**given)


@pytest.mark.parametrize(("delay", "horizon"), [(16, 16), (60, 20)])
def test_delays_beyond_the_horizon_are_refused(tmp_path: Path, delay: int, horizon: int) -> None:
    given = settings(
        tmp_path, late=Late(delays=(1, delay)), changes=(f"association.horizon={horizon}",)
    )

    with pytest.raises(SettingsError, match=f"plans reach {horizon} frames, those {delay} frames"):
        train(given, say=pytest.fail)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_an_episode_that_ends_before_a_choice_takes_effect_is_not_scored(tmp_path: Path) -> None:
    short = [recording(tmp_path, frames=2)]
    able = Clips(
        recordings=short, rules=training.Rules(roi_channels=ROI), settings=settings(tmp_path)
    )

    assert training.coverage(PolicyNet(roi_channels=ROI), able, count=4, seed=1) == {}


def test_a_round_without_samples_is_refused(
    tmp_path: Path, clips: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(settings(tmp_path), PolicyNet(roi_channels=ROI))
    able = Clips(recordings=clips, rules=training.Rules(roi_channels=ROI), settings=run.settings)
    monkeypatch.setattr(training, "roll", lambda *_, **__: [])

    with pytest.raises(RunError, match="round 1: expected moments in which a choice is worth"):
        round_of(run, able, 1)


def test_a_round_is_the_same_for_the_same_number_and_policy(
    tmp_path: Path, clips: list[Recording]
) -> None:
    given = settings(tmp_path)
    torch.manual_seed(1)
    run = Run(given, PolicyNet(roi_channels=ROI))
    able = Clips(recordings=clips, rules=training.Rules(roi_channels=ROI), settings=given)

    first, again, other = (round_of(run, able, n) for n in (1, 1, 2))

    assert np.array_equal(first.kept["condition"], again.kept["condition"])
    assert not np.array_equal(first.kept["condition"], other.kept["condition"])
    assert replace(given, seed=2) != given


@pytest.mark.parametrize("room", [True, False])
def test_a_round_on_another_device_gives_the_same_and_mixes_no_devices(
    tmp_path: Path, clips: list[Recording], monkeypatch: pytest.MonkeyPatch, room: bool
) -> None:
    given = settings(tmp_path)
    able = Clips(recordings=clips, rules=training.Rules(roi_channels=ROI), settings=given)

    def learned() -> tuple[Run, list[float]]:
        torch.manual_seed(1)
        run = Run(given, PolicyNet(roi_channels=ROI))
        samples = round_of(run, able, 1)
        return run, [figure for _ in range(3) for figure in advance(run, samples)]

    _, wanted = learned()
    monkeypatch.setattr(training, "device_of", lambda _: PLACE)
    monkeypatch.setattr(pool, "has_room", lambda *_: room)
    with pretended():
        there, found = learned()

    assert {p.device for p in there.net.parameters()} == {PLACE}
    assert found == pytest.approx(wanted, rel=1e-3)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.usefixtures("clips")
def test_a_training_on_a_gpu_resumes_without_one(tmp_path: Path) -> None:
    export(train(settings(tmp_path, device="cuda"), say=lambda _: None), tmp_path / "policy.onnx")

    net = train(settings(tmp_path, iterations=18), say=lambda _: None)

    assert {p.device.type for p in net.parameters()} == {"cpu"}
    assert PolicyNetwork(tmp_path / "policy.onnx").roi_channels == ROI


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--use", "roi,smell", "expected some of roi, global, motion, got smell"),
        ("--delays", "soon", "--delays: expected frames such as 1,2,4, got 'soon'"),
        ("--device", "gpu", "device: expected auto, cpu, cuda, cuda:N or mps, got gpu"),
        ("--rate", "nan", "rate: must be above 0, got nan"),
        ("--set", "nonsense=1", "--set nonsense=1: expected node.setting=value"),
        ("--set", "saliency.weights=gone.onnx", "gone.onnx: no such file"),
        ("--out", __file__, "test_train.py: expected a folder, got a file"),
        ("--replans", "0", "--replans: expected frames such as 1,2,4, got '0'"),
    ],
)
def test_wrong_options_are_refused(tmp_path: Path, option: str, value: str, said: str) -> None:
    words = ["--data", str(tmp_path), "--out", str(tmp_path), option, value]

    result = CliRunner().invoke(command, words)

    assert result.exit_code == 2
    assert said in result.output
