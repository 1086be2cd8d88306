"""What the README shows is true: its operator runs, its graph lines fit, its commands exist."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from pipeline import Frame
from pipeline.cli import commands
from pipeline.graph.loader import load
from pipeline.testing import drive, header

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    path = tmp_path / "mine.py"
    path.write_text(blocks("python")[0])
    monkeypatch.syspath_prepend(str(tmp_path))
    spec = importlib.util.spec_from_file_location("mine", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_operator_of_the_readme_does_what_it_says(mine: Any) -> None:
    frame = Frame(header=header(1), pixels=np.full((4, 6, 3), 100, np.uint8), window=(0, 0, 6, 4))

    (bright,) = drive(mine.Brighten, [frame], {"gain": 2})

    assert (bright.pixels == 200).all()
    assert bright.window == frame.window


def test_the_node_of_the_readme_fits_into_the_tracking_graph(mine: Any, tmp_path: Path) -> None:
    text = (ROOT / "graphs" / "tracking.yaml").read_text()
    path = tmp_path / "graph.yaml"
    path.write_text(text + blocks("yaml")[0])

    plan = load(path)

    assert plan.node("brighten").settings == {"gain": 2}
    assert YAML(typ="safe").load(blocks("yaml")[0])["brighten"]["operator"] == "mine:Brighten"


def test_every_command_of_the_readme_exists() -> None:
    named = set(re.findall(r"`fovea (\w+)", README))

    assert named <= set(commands.commands), named - set(commands.commands)


def test_every_bench_of_the_readme_exists() -> None:
    named = set(re.findall(r"python -m (bench\.\w+)", README))

    assert named
    paths = [ROOT / name.replace(".", "/") for name in named]
    assert all(p.with_suffix(".py").is_file() or (p / "__main__.py").is_file() for p in paths), (
        named
    )
