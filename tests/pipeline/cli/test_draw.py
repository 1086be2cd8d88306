"""`fovea draw --live` writes the rates of a running graph at its edges."""

import re
import secrets
import subprocess
import sys
from pathlib import Path

import psutil

from pipeline.run.rundir import running
from tests.commands import command
from tests.sample_graphs import CHAIN, together

FOVEA = (sys.executable, "-m", "pipeline.entry")


def test_every_edge_of_a_running_graph_has_its_rate(tmp_path: Path) -> None:
    path, name = tmp_path / "graph.yaml", f"draw-{secrets.token_hex(3)}"
    path.write_text(f"name: {name}\n{together(CHAIN, 'ticker', 'count', 'glance')}")
    subprocess.run([*FOVEA, "run", str(path), "--detach"], check=True, capture_output=True)
    try:
        done = command("draw", str(path), "--text", "--live")
    finally:
        psutil.Process(running()[name]["pid"]).kill()

    assert done.returncode == 0, done.stderr
    edges = [line for line in done.stdout.splitlines() if "←" in line]
    assert edges
    rates = [float(re.search(r", ([0-9.]+)/s", line)[1]) for line in edges]  # type: ignore[index]
    assert max(rates) > 0
