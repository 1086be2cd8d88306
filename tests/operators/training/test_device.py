"""Devices: names that are accepted or refused in a sentence, and tensors that are moved."""

import pytest

pytest.importorskip("torch", reason="needs the train extra")
import torch

from operators.training.device import device_of, has_room, mixed_precision, moved
from pipeline import SettingsError
from tests.operators.training.elsewhere import PLACE, pretended

CPU = torch.device("cpu")


@pytest.mark.parametrize("name", ["gpu", "", "CUDA", "cuda:", "cuda:-1", "cpu:0", "meta"])
def test_a_name_of_no_device_is_refused(name: str) -> None:
    with pytest.raises(SettingsError) as refused:
        device_of(name)

    assert str(refused.value) == f"device: expected auto, cpu, cuda, cuda:N or mps, got {name}"


def test_a_device_that_is_not_there_is_refused() -> None:
    seen = torch.cuda.device_count()

    with pytest.raises(SettingsError) as refused:
        device_of(f"cuda:{seen}")

    assert str(refused.value) == f"device: no CUDA device {seen} here, torch sees {seen}"


def test_auto_is_a_gpu_where_there_is_one() -> None:
    assert device_of("auto").type == ("cuda" if torch.cuda.is_available() else "cpu")


@pytest.mark.parametrize(
    ("told", "precision"),
    [
        ({"avx2": True, "avx512_bf16": False}, torch.float32),
        ({"avx2": True, "avx512_bf16": True}, torch.bfloat16),
        ({"neon": True}, torch.float32),
        ({"neon": True, "bf16": True}, torch.bfloat16),
    ],
)
def test_a_processor_without_bfloat16_computes_in_single_precision(
    told: dict[str, bool], precision: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: told, raising=False)

    with mixed_precision(CPU):
        product = torch.ones(2, 2) @ torch.ones(2, 2)

    assert product.dtype == precision


@pytest.mark.parametrize("has", [False, True])
def test_an_older_torch_tells_it_too(has: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(torch.cpu, "get_capabilities", raising=False)
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: has)

    with mixed_precision(CPU):
        assert ((torch.ones(2, 2) @ torch.ones(2, 2)).dtype == torch.bfloat16) == has


def test_nothing_is_copied_on_the_cpu() -> None:
    values = torch.arange(3)

    assert moved(values, CPU) is values
    assert not has_room(CPU, 1)


def test_an_operation_on_both_devices_is_an_error_without_a_gpu() -> None:
    with pretended():
        there = torch.ones(3).to(PLACE) + torch.ones(3, device=PLACE)

        assert there.device == PLACE
        assert there.cpu().tolist() == [2, 2, 2]
        with pytest.raises(RuntimeError, match="some tensors are here, others elsewhere"):
            there + torch.ones(3)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_tensors_that_fit_are_moved_to_a_gpu() -> None:
    device = device_of("cuda")

    there = moved(torch.arange(3), device)

    assert there.device.type == "cuda"
    assert there.tolist() == [0, 1, 2]
    assert has_room(device, 1)
    assert not has_room(device, 1 << 50)
