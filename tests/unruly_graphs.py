"""A graph with one misbehaving operator, and functions to run it in tests."""

import secrets
from pathlib import Path
from typing import Any

from pipeline.graph.plan import Plan
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import handled, plan_of, wait_for

UNRULY = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    settings: {rate_hz: 20, side_px: 60}
  unruly:
    operator: tests.faulty_samples:Unruly
    restart: {backoff_s: 0.01}
    inputs: {frame: {from: ticker.context, depth: 60}}
  after:
    operator: tests.samples:Count
    inputs: {frame: {from: unruly, depth: 60}}
"""


def unruly_plan(tmp_path: Path, *, text: str = UNRULY, clock: str = "", **settings: Any) -> Plan:
    """The graph with an unruly part of these settings."""
    changes = tuple(f"unruly.{name}={value}" for name, value in settings.items())
    return plan_of(tmp_path, text, changes=changes, clock=clock)


def unruly_file(tmp_path: Path, *, text: str = UNRULY, **settings: Any) -> Path:
    """Likewise, as a file for the command line."""
    if settings:
        words = ", ".join(f"{name}: {value}" for name, value in settings.items())
        operator = "    operator: tests.faulty_samples:Unruly\n"
        text = text.replace(operator, f"{operator}    settings: {{{words}}}\n")
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: unruly-{secrets.token_hex(3)}\n{text}")
    return path


def name_of(graph: Path) -> str:
    """The name that a graph's file gives it."""
    return graph.read_text().splitlines()[0].split()[1]


def recovers(supervisor: Supervisor) -> None:
    """The unruly part comes back once, and frames arrive behind it."""
    wait_for(supervisor, lambda: supervisor.restarts.get("unruly") == 1, 60)
    seen = handled(supervisor, "after")
    wait_for(supervisor, lambda: handled(supervisor, "after") > seen + 5, 60)
    supervisor.finish()
