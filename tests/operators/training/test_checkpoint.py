"""The same training resumes where it stopped; a checkpoint of another one is refused."""

from collections.abc import Mapping
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the train extra")
import torch
from torch import nn

from operators.training import checkpoint
from operators.training.checkpoint import Progress
from pipeline import SettingsError, WeightsError
from tests.full_disk import full_disk

TOLD = {"seed": "1", "rate": "0.001"}


def progress(folder: Path, told: Mapping[str, str] = TOLD, sides: int = 2) -> Progress:
    """Return the progress of a network and its optimiser after one step."""
    net = nn.Linear(sides, 1)
    optimiser = torch.optim.AdamW(net.parameters())
    net(torch.ones(1, sides)).sum().backward()
    optimiser.step()
    return Progress(folder, {"net": net, "optimiser": optimiser}, told)


def test_a_training_restores_what_it_saved(tmp_path: Path) -> None:
    first, second = progress(tmp_path), progress(tmp_path)
    first.step, first.elapsed_s = 7, 1.5

    first.save()
    second.resume()

    assert (second.step, second.elapsed_s) == (7, 1.5)
    assert torch.equal(first.parts["net"].weight, second.parts["net"].weight)  # type: ignore[attr-defined]
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.pt"]


def test_without_a_checkpoint_a_training_starts_at_step_0(tmp_path: Path) -> None:
    first = progress(tmp_path)

    first.resume()

    assert first.step == 0


def test_an_interruption_loses_less_than_a_minute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = progress(tmp_path)

    first.save_when_due()
    assert not first.path.exists()
    monkeypatch.setattr(checkpoint, "EVERY_S", 0.0)
    first.save_when_due()

    assert first.path.exists()


def test_another_training_is_refused_by_name(tmp_path: Path) -> None:
    progress(tmp_path).save()
    other = progress(tmp_path, {"seed": "9", "rate": "0.001", "late": "on"})

    with pytest.raises(SettingsError) as refused:
        other.resume()

    assert str(refused.value) == (
        "late: this folder's training has none, got on; seed: this folder's training has 1, got 9; "
        f"use another --out, or remove {tmp_path / 'checkpoint.pt'}"
    )


def test_a_checkpoint_without_settings_is_refused(tmp_path: Path) -> None:
    torch.save({"net": {}, "step": 3}, tmp_path / "checkpoint.pt")

    with pytest.raises(WeightsError, match=r"checkpoint\.pt: .* earlier version; use "):
        progress(tmp_path).resume()


def test_parts_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    progress(tmp_path, sides=3).save()

    with pytest.raises(WeightsError, match=r"checkpoint\.pt: expected this training's net, got"):
        progress(tmp_path).resume()


@pytest.mark.parametrize("state", [{}, {"net": 3}, {"net": {"weight": 3, "bias": 4}}])
def test_missing_parts_are_refused(tmp_path: Path, state: dict[str, object]) -> None:
    told = {"step": 1, "elapsed_s": 0.0, "settings": TOLD}
    torch.save(state | told, tmp_path / "checkpoint.pt")

    with pytest.raises(WeightsError, match=r"checkpoint\.pt: expected this training's net, got"):
        progress(tmp_path).resume()


@pytest.mark.parametrize(("left", "got"), [(900, "PytorchStreamReader"), (0, "nothing|Ran out")])
def test_a_file_that_is_no_checkpoint_is_refused(tmp_path: Path, left: int, got: str) -> None:
    progress(tmp_path).save()
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(path.read_bytes()[:left])

    with pytest.raises(WeightsError, match=rf"\.pt: expected a state dict of tensors, got ({got})"):
        progress(tmp_path).resume()


def test_a_full_disk_is_told_as_such_and_leaves_the_checkpoint_before(tmp_path: Path) -> None:
    first = progress(tmp_path, sides=4000)
    first.save()
    before = first.path.read_bytes()

    with full_disk(), pytest.raises(OSError, match="File too large"):
        first.save()

    assert first.path.read_bytes() == before


def test_a_damaged_checkpoint_is_refused_and_stays(tmp_path: Path) -> None:
    first = progress(tmp_path, sides=5000)
    first.save()
    whole = first.path.read_bytes()
    middle = len(whole) // 2  # in the numbers of a tensor, which torch loads without checking them
    damaged = whole[:middle] + bytes(64) + whole[middle + 64 :]
    first.path.write_bytes(damaged)

    with pytest.raises(WeightsError, match=r"checkpoint\.pt: expected .*, got a damaged part, "):
        first.resume()

    assert first.path.read_bytes() == damaged
