"""Training of the policy that acts: it learns, resumes, and exports what the operator reads."""

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import torch
from click.testing import CliRunner

from operators.acting import training_run
from operators.acting.data import MOST, made_with, read
from operators.acting.model import ActingNet
from operators.acting.network import ActingNetwork
from operators.acting.train import command
from operators.acting.windows import FACTS
from operators.training import arrays as files
from pipeline.errors import DriverError

needs_robot = pytest.mark.skipif(
    not (find_spec("mujoco") and find_spec("gym_aloha")), reason="needs the robot extra"
)
TRIED, CHANNELS = 12, 4


def moments(seed: int, count: int = 40) -> files.Arrays:
    """Windows that gain the more, the longer ago they were shown; a third was not tried."""
    random = np.random.default_rng(seed)
    facts = random.random((count, MOST, FACTS)).astype(np.float32)
    gains = 0.01 * facts[..., 6]
    gains[:, TRIED:] = np.nan
    present = np.zeros((count, MOST), np.bool_)
    present[:, : TRIED + 6] = True
    return {
        "facts": facts, "gains": gains, "present": present,
        "appearance": random.random((count, MOST, CHANNELS)).astype(np.float32),
        "joints": random.random((count, 14)).astype(np.float32),
    }  # fmt: skip


def recorded(seeds: range, folder: Path, *, weights: Path | None, **_: Any) -> list[Path]:
    """Stands for `record`: no robot."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{seed:05d}.npz" for seed in seeds]
    for seed, path in zip(seeds, paths, strict=True):
        files.write(path, moments(seed), made_with(weights))
    return paths


def trained(folder: Path, *more: str) -> str:
    words = [f"--data={folder / 'data'}", f"--out={folder / 'out'}", "--trials=2", "--batch=16"]
    found = CliRunner().invoke(command, [*words, *more], catch_exceptions=False)
    assert found.exit_code == 0, found.output
    return found.output


def test_it_learns_what_gains_and_exports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training_run, "record", recorded)

    trained(tmp_path, "--iterations=150")

    result = json.loads((tmp_path / "out" / "round_2" / "result.json").read_text())
    assert result["any"] < 0.006
    assert result["chosen"] > 0.8 * result["best"]
    known = moments(77, 1)
    subject = ActingNetwork(tmp_path / "out" / "acting.onnx")
    told = subject(known["facts"][0], known["appearance"][0], known["joints"][0])
    assert np.corrcoef(told, known["facts"][0, :, 6])[0, 1] > 0.7


def test_a_finished_round_is_not_trained_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training_run, "record", recorded)
    trained(tmp_path, "--iterations=20")
    first = (tmp_path / "out" / "acting.onnx").read_bytes()

    def never(*_: object) -> float:
        raise AssertionError("trained again")

    monkeypatch.setattr(training_run, "_advance", never)
    trained(tmp_path, "--iterations=20")

    assert (tmp_path / "out" / "acting.onnx").read_bytes() == first


def test_the_order_of_windows_does_not_matter_and_absent_ones_do_not_count() -> None:
    torch.manual_seed(3)
    subject, known = ActingNet(channels=CHANNELS).eval(), moments(5, 1)
    facts, looks, joints = (
        torch.from_numpy(known[name]) for name in ("facts", "appearance", "joints")
    )
    order = torch.randperm(9, generator=torch.Generator().manual_seed(4))
    present = torch.arange(MOST)[None] < 9

    told = subject(facts[:, :9], looks[:, :9], joints)

    turned = subject(facts[:, order], looks[:, order], joints)
    torch.testing.assert_close(turned, told[:, order])
    torch.testing.assert_close(subject(facts, looks, joints, present)[:, :9], told)


def test_a_file_without_gains_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "0.npz"
    files.write(path, {"facts": np.zeros(3)}, {})

    with pytest.raises(DriverError, match="expected valued windows"):
        read([path])


@needs_robot
def test_a_trial_tells_what_windows_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    from operators.acting import data, rollout

    monkeypatch.setattr(rollout, "STEPS", 6)

    found = data.valued(2_999, None)

    assert found["facts"].shape == (len(found["joints"]), MOST, FACTS)
    assert 1 <= len(found["joints"]) <= 2
    tried = ~np.isnan(found["gains"])
    assert tried.sum() <= data.TRIED * len(tried)
    assert not (tried & ~found["present"]).any()
    # at the start nothing was shown yet: looking somewhere brings the chunk nearer
    assert np.nanmax(found["gains"]) > 0
    assert (found["change"] > 0).all()
