"""Networks as ONNX files: whole, with their metadata, or as they were."""

from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import onnx
import torch
from torch import nn

from operators.training.onnx_files import describe, write
from tests.full_disk import full_disk


def written(path: Path) -> Path:
    write(nn.Linear(4000, 2), {"x": torch.zeros(1, 4000)}, path, ("y",), task="detect")
    return path


def facts_of(path: Path) -> dict[str, str]:
    return {p.key: p.value for p in onnx.load(path).metadata_props}


def test_facts_are_added_to_a_network(tmp_path: Path) -> None:
    path = written(tmp_path / "a.onnx")

    describe(path, {"confidence": "0.5"})

    assert facts_of(path) == {"task": "detect", "confidence": "0.5"}


def test_a_full_disk_leaves_the_network_before(tmp_path: Path) -> None:
    path = written(tmp_path / "a.onnx")
    before = path.read_bytes()

    with full_disk(), pytest.raises(OSError, match="File too large"):
        describe(path, {"confidence": "0.5"})
    with full_disk(), pytest.raises(OSError, match="File too large"):
        written(path)

    assert path.read_bytes() == before
