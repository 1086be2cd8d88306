"""Without torch, a training prints its options, and refuses to run in one sentence."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
MODULES = [f"operators.{part}.train" for part in ("policy", "roi_features", "saliency")]
WITHOUT = """
import runpy, sys
for package in ("torch", "onnx", "tqdm"):
    sys.modules[package] = None
module, *words = sys.argv[1:]
sys.argv = [module, *words]
runpy.run_module(module, run_name="__main__", alter_sys=True)
"""


def without_torch(*words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", WITHOUT, *words],
        cwd=ROOT, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("words", [[module] for module in MODULES] + [["pipeline.cli"]])
def test_the_options_are_printed_without_torch(words: list[str]) -> None:
    task = ["train", "tracking"] if words == ["pipeline.cli"] else []

    done = without_torch(*words, *task, "--help")

    assert done.returncode == 0, done.stderr
    assert {"--data", "--out", "--device"} <= set(done.stdout.replace(" ", "\n").splitlines())


@pytest.mark.parametrize("module", MODULES)
def test_a_training_without_torch_is_refused_in_one_sentence(module: str, tmp_path: Path) -> None:
    done = without_torch(module, "--data", str(tmp_path / "data"), "--out", str(tmp_path / "out"))

    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "expected the package torch, got none: pip install 'fovea[train]'" in line
    assert "--extra-index-url https://download.pytorch.org/whl/cpu" in line
    assert not any(tmp_path.iterdir())
