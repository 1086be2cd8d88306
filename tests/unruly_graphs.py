"""A graph with one misbehaving operator, and functions to run it in tests."""

import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pipeline.graph.plan import Plan
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import handled, plan_of, wait_for

UNRULY = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    group: ends
    settings: {rate_hz: 20, side_px: 60}
  unruly:
    operator: tests.faulty_samples:Unruly
    restart: {backoff_s: 0.01}
    inputs: {frame: {from: ticker.context, depth: 60}}
  after:
    operator: tests.samples:Count
    group: ends
    inputs: {frame: {from: unruly, depth: 60}}
"""

PART = """\
  {name}:
    operator: tests.faulty_samples:Unruly
    restart: {{backoff_s: 0.01}}
    settings: {{kind: {kind}, once: "{folder}/once-{name}", note: "{folder}/note-{name}"}}
    inputs: {{frame: {{from: ticker.context, depth: 40}}}}
  after_{name}:
    operator: tests.samples:Count
    group: ends
    inputs: {{frame: {{from: {name}, depth: 60}}}}
"""


def unruly_parts(folder: Path, kinds: Mapping[str, str]) -> str:
    """Return a graph with an operator of each kind, in processes of their own, each with a reader.

    Each operator writes its notes to `note-NAME` in the folder.
    """
    head = UNRULY[: UNRULY.index("  unruly:")]
    parts = (PART.format(name=name, kind=kind, folder=folder) for name, kind in kinds.items())
    return head + "".join(parts)


def unruly_plan(tmp_path: Path, *, text: str = UNRULY, clock: str = "", **settings: Any) -> Plan:
    """Load the graph with these settings of the unruly operator."""
    changes = tuple(f"unruly.{name}={value}" for name, value in settings.items())
    return plan_of(tmp_path, text, changes=changes, clock=clock)


def unruly_file(tmp_path: Path, *, text: str = UNRULY, **settings: Any) -> Path:
    """Write the same graph to a file for the command line; return its path."""
    if settings:
        words = ", ".join(f"{name}: {value}" for name, value in settings.items())
        operator = "    operator: tests.faulty_samples:Unruly\n"
        text = text.replace(operator, f"{operator}    settings: {{{words}}}\n")
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: unruly-{secrets.token_hex(3)}\n{text}")
    return path


def name_of(graph: Path) -> str:
    """Return the name of a graph from its file."""
    return graph.read_text().splitlines()[0].split()[1]


def recovers(supervisor: Supervisor) -> None:
    """Wait until the unruly node was restarted once and frames arrive after it; then finish."""
    wait_for(supervisor, lambda: supervisor.restarts.get("unruly") == 1, 60)
    seen = handled(supervisor, "after")
    wait_for(supervisor, lambda: handled(supervisor, "after") > seen + 5, 60)
    supervisor.finish()


def all_recover(supervisor: Supervisor, names: Iterable[str]) -> None:
    """Wait until each of these nodes was restarted and frames arrive after it; then finish."""
    names = list(names)
    wait_for(supervisor, lambda: all(supervisor.restarts.get(name) for name in names))
    seen = {name: handled(supervisor, f"after_{name}") for name in names}
    wait_for(
        supervisor,
        lambda: all(handled(supervisor, f"after_{name}") > seen[name] + 5 for name in names),
    )
    supervisor.finish()
