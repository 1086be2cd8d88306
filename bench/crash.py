"""Measure recovery from SIGKILL: `python -m bench.crash [GRAPH] --count 20 [--json FILE]`.

Runs a graph of processes in real time and kills each operator several times. It reports for every
kill the time until the operator has handled a frame again, and how much of that was loading its
model; for every operator the largest memory growth of another process meanwhile; at the end the
edges' accounts and what is left in shared memory.
"""

import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
import psutil
from rich.console import Console
from rich.progress import track
from rich.table import Table

from bench.leftovers import Traces, run_for, unbalanced
from bench.machine import facts
from bench.options import JSON, Bench, file_name, on_graph
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Node
from pipeline.run.report import compose
from pipeline.run.supervisor import Supervisor

ASKED_S = 1.0  # plus the time to load the model
SETTLE_S = 3.0  # between two kills, in which the spare process can start
TIMEOUT_S = 30.0


@click.command(cls=Bench)
@on_graph
@click.option("--count", default=20, show_default=True, type=click.IntRange(1))
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], count: int, path: Path | None
) -> None:
    """Kill every operator of a graph several times."""
    plan = load(graph, Overlay(source=source, changes=changes, clock="realtime"))
    kills: list[dict[str, Any]] = []
    with Supervisor(plan) as supervisor:
        supervisor.allow_restarts(count * len(plan.nodes) + 10)
        supervisor.start()
        traces = Traces.of(plan.name)
        run_for(supervisor, 2.0)
        grown: dict[str, float] = {}
        for node in plan.nodes:
            memory = _memory(supervisor)
            for _ in track(range(count), f"killing {node.name}"):
                kills.append({"node": node.name, **_kill(supervisor, node)})
                run_for(supervisor, SETTLE_S)
            after = _memory(supervisor)
            grown[node.name] = max(after[p] - memory[p] for p in memory if p != node.process)
        supervisor.finish()
        supervisor.stop()
        report = compose(plan, supervisor.ledger, {}, {}, duration_s=1.0)
    result = {
        "bench": "crash", **facts(), "graph": file_name(graph), "count": count,
        "edges": report["edges"], "unbalanced": unbalanced(report["edges"]),
        "left": traces.files(), "grown_mb": grown, "kills": kills,
        "recovery": {node.name: _summary(kills, node.name) for node in plan.nodes},
    }  # fmt: skip
    console = Console()
    console.print(_table(result))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1))


def _kill(supervisor: Supervisor, node: Node) -> dict[str, float]:
    account = supervisor.ledger.nodes[node.index]
    handled, epoch = account.handled, account.epoch
    began = time.monotonic()
    os.kill(supervisor.pid(node.process), signal.SIGKILL)
    while not (account.epoch > epoch and account.handled > handled + 1):
        if time.monotonic() - began > TIMEOUT_S or supervisor.failure:
            raise click.ClickException(f"{node.name} did not recover: {supervisor.failure}")
        supervisor.tick()
    recovered_s = time.monotonic() - began
    return {"recovered_s": recovered_s, "load_s": supervisor.load_s(node.process)}


def _memory(supervisor: Supervisor) -> dict[str, float]:
    """Return resident megabytes by process."""
    return {
        process: psutil.Process(supervisor.pid(process)).memory_info().rss / 1e6
        for process in supervisor.plan.processes()
    }


def _summary(kills: list[dict[str, Any]], node: str) -> dict[str, float]:
    mine = [k for k in kills if k["node"] == node]
    beyond = np.array([k["recovered_s"] - k["load_s"] for k in mine])
    return {
        "recovered_p50_s": float(np.median([k["recovered_s"] for k in mine])),
        "load_p50_s": float(np.median([k["load_s"] for k in mine])),
        "beyond_load_p50_s": float(np.median(beyond)),
        "beyond_load_max_s": float(beyond.max()),
    }


def _table(result: dict[str, Any]) -> Table:
    table = Table(title=f"SIGKILL, {result['count']} times each; asked: {ASKED_S} s beyond loading")
    for column in ("node", "recovered p50 s", "load p50 s", "beyond p50 s", "max s", "others MB"):
        table.add_column(column, justify="right")
    for node, figures in result["recovery"].items():
        grown = result["grown_mb"][node]
        table.add_row(node, *(f"{v:.2f}" for v in figures.values()), f"{grown:+.1f}")
    unbalanced = ", ".join(result["unbalanced"]) or "none"
    left = ", ".join(result["left"]) or "nothing"
    table.caption = f"accounts that do not add up: {unbalanced}; left behind: {left}"
    return table


if __name__ == "__main__":
    main()
