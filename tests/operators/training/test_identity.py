"""Identities of results: they change with all code that the figures depend on."""

import re
from pathlib import Path

import pytest

from operators.training.identity import SHARED, differing, of_plan
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay

ROOT = Path(__file__).resolve().parents[3]
IMPORTED = re.compile(r"^from (pipeline\.\w+) import", re.MULTILINE)
WITHOUT_FIGURES = {"pipeline.contract", "pipeline.testing"}


def test_what_operators_calculate_with_belongs_to_the_identity_of_a_graph() -> None:
    files = (ROOT / "operators").rglob("*.py")
    imported = {name for file in files for name in IMPORTED.findall(file.read_text())}
    arrays = {
        name
        for name in imported - WITHOUT_FIGURES
        if (file := ROOT / f"{name.replace('.', '/')}.py").exists()
        and "import numpy" in file.read_text()
    }

    found = of_plan(load(ROOT / "graphs" / "tracking.yaml"))

    assert "pipeline.colours" in arrays <= set(SHARED)
    assert {f"code of {name}" for name in SHARED} <= found.keys()


WORLD = """
from drivers.scenes import SoccerScene

class World(SoccerScene):
    pass
"""


def test_the_code_of_a_scene_of_ones_own_belongs_to_the_identity(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    file = tmp_path / "own_world.py"
    file.write_text(WORLD)
    graph, scene = ROOT / "graphs" / "tracking.yaml", "capture.options.scene=own_world:World"
    plan = load(graph, Overlay(changes=(scene,)))
    before = of_plan(plan)

    file.write_text(f"{WORLD}    darker = True\n")

    assert differing(before, of_plan(plan)) == ["code of own_world:World"]
