"""Identities of results: they change with all code that the figures depend on."""

import re
from pathlib import Path

from operators.training.identity import SHARED, of_plan
from pipeline.graph.loader import load

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
