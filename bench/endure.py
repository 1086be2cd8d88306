"""Check that a supervisor does not grow with kills and swaps: `python -m bench.endure --kills 300`.

Runs a small graph of sample operators in real time and repeatedly kills one of its nodes while it
swaps another. Every 50 events it records the supervisor's memory, open files and threads, and the
files of the run. With `--json FILE` it writes the figures after every record. The supervisor's
memory grows for the first twelve minutes, until its samples of the processes are complete.
"""

import json
import os
import secrets
import signal
import tempfile
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import click
import numpy as np
import psutil
from rich.console import Console
from rich.progress import track

from bench.leftovers import Traces, unbalanced
from bench.machine import facts
from bench.options import JSON, Bench
from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from pipeline.protocol.orders import Refused, Result, SwapOrder
from pipeline.run.memory_folder import path_of
from pipeline.run.report import compose
from pipeline.run.supervisor import Supervisor
from pipeline.terminal import lean_table

GRAPH = """\
name: endure-{token}
nodes:
  metronome:
    operator: bench.samples:Metronome
  first:
    operator: bench.samples:Forward
    inputs: {{frame: {{from: metronome, depth: 60}}}}
  second:
    operator: bench.samples:Forward
    restart: {{backoff_s: 0.001}}
    inputs: {{frame: {{from: first, depth: 60}}}}
  sink:
    operator: bench.samples:Sink
    inputs: {{frame: {{from: second, depth: 60}}}}
"""
KILLED, SWAPPED, LAST = "second", "first", "sink"
EVERY = 50  # events between two looks
TIMEOUT_S = 60.0
PROBATION = 2  # frames


@click.command(cls=Bench)
@click.option("--kills", default=300, show_default=True, type=click.IntRange(0))
@click.option("--swaps", default=300, show_default=True, type=click.IntRange(0))
@JSON
def main(kills: int, swaps: int, path: Path | None) -> None:
    """Kill one node and swap another repeatedly, both at once."""
    plan = sample_plan()
    events = schedule(kills, swaps)
    looks: list[dict[str, float]] = []
    refused: list[str] = []
    result: dict[str, Any] = {
        "bench": "endure", **facts(), "kills": kills, "swaps": swaps, "refused": refused,
        "events": 0, "looks": looks,
    }  # fmt: skip
    with Supervisor(plan) as supervisor:
        supervisor.allow_restarts(kills + 10)
        supervisor.start()
        traces = Traces.of(plan.name)
        _until(supervisor, lambda: _handled(supervisor, LAST) > 50)
        looks.append(look(supervisor, traces, 0))
        count = 0
        for together in track(events, "kills and swaps"):
            count += len(together)
            if sentence := _endure(supervisor, together):
                refused.append(sentence)
            if count // EVERY > looks[-1]["events"] // EVERY or together is events[-1]:
                looks.append(look(supervisor, traces, count))
                result["events"] = count
                _write(path, result)
        supervisor.finish()
        supervisor.stop()
        report = compose(supervisor.plan, supervisor.ledger, {}, {}, duration_s=1.0)
    result |= {
        "growth_kb_per_event": growth_kb(looks), "unbalanced": unbalanced(report["edges"]),
        "left": traces.files(), "orphans": traces.orphans(),
    }  # fmt: skip
    _show(result)
    _write(path, result)


def sample_plan() -> Plan:
    """Return a plan of four sample operators with a unique name."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "graph.yaml"
        file.write_text(GRAPH.format(token=secrets.token_hex(3)))
        return load(file)


def schedule(kills: int, swaps: int) -> list[tuple[str, ...]]:
    """Return kills and swaps, spread evenly over the run; where possible both happen at once.

    >>> schedule(2, 1), schedule(0, 2)
    ([('kill',), ('kill', 'swap')], [('swap',), ('swap',)])
    """
    rounds = max(kills, swaps)
    return [
        tuple(
            name
            for name, count in (("kill", kills), ("swap", swaps))
            if (i + 1) * count // rounds > i * count // rounds
        )
        for i in range(rounds)
    ]


def look(supervisor: Supervisor, traces: Traces, events: int) -> dict[str, float]:
    """Return the supervisor's resources."""
    own = psutil.Process()
    with own.oneshot():
        memory = own.memory_info()
        return {
            "events": events,
            "at_s": round(time.monotonic() - supervisor.started_s, 1),
            "rss_mb": round(memory.rss / 1e6, 3),
            "own_mb": round((memory.rss - memory.shared) / 1e6, 3),
            "open_files": own.num_fds(),
            "threads": own.num_threads(),  # with those of Zenoh's pool, which grows with work
            "run_files": sum(1 for _ in traces.folder.rglob("*")),
            "memory_files": len(list(path_of(traces.run_id).iterdir())),
            "children": len(own.children(recursive=True)),
        }


def growth_kb(looks: list[dict[str, float]]) -> float:
    """Return the slope of the supervisor's own memory over the later half of the events.

    >>> growth_kb([{"events": n, "own_mb": max(50, 50 + (n - 50) / 1000)} for n in range(100)])
    1.0
    """
    late = [(x["events"], x["own_mb"]) for x in looks if x["events"] * 2 >= looks[-1]["events"]]
    if len(late) < 2:
        return 0.0
    events, memory = np.array(late).T
    return round(float(np.polyfit(events, memory, 1)[0]) * 1000, 3)


def _endure(supervisor: Supervisor, events: Collection[str]) -> str:
    """Kill, swap, or both at once; return why the swap was refused, or an empty string."""
    answers: list[Result] = []
    account = supervisor.ledger.nodes[supervisor.plan.node(KILLED).index]
    epoch, handled = account.epoch, account.handled
    if "swap" in events:
        order = SwapOrder(node=SWAPPED, probation=PROBATION)
        supervisor.control.take(order, answers.append)
    if "kill" in events:
        os.kill(supervisor.pid(KILLED), signal.SIGKILL)
        _until(supervisor, lambda: account.epoch > epoch and account.handled > handled)
    if "swap" in events:
        _until(supervisor, lambda: bool(answers))
    return answers[0].reason if answers and isinstance(answers[0], Refused) else ""


def _handled(supervisor: Supervisor, node: str) -> int:
    return int(supervisor.ledger.nodes[supervisor.plan.node(node).index].handled)


def _until(supervisor: Supervisor, holds: Callable[[], bool]) -> None:
    late_s = time.monotonic() + TIMEOUT_S
    while not holds():
        if supervisor.failure or time.monotonic() > late_s:
            raise click.ClickException(supervisor.failure or "no progress in time")
        supervisor.tick()


def _write(path: Path | None, result: dict[str, Any]) -> None:
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1) + "\n")


def _show(result: dict[str, Any]) -> None:
    names = [name for name in result["looks"][0] if name != "events"]
    table = lean_table("the supervisor", figures=["events", *names])
    for one in result["looks"]:
        table.add_row(str(one["events"]), *(f"{one[name]:g}" for name in names))
    console = Console()
    console.print(table)
    console.print(
        f"{result['growth_kb_per_event']:.2f} kB an event over the later half; refused swaps: "
        f"{len(result['refused'])}; unbalanced: {', '.join(result['unbalanced']) or 'none'}; "
        f"left behind: {', '.join(result['left']) or 'nothing'}, {len(result['orphans'])} processes"
    )


if __name__ == "__main__":
    main()
