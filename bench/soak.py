"""Whether memory grows: `python -m bench.soak [GRAPH] --minutes 30 [--json FILE]`.

Runs a graph of processes in real time and compares every process's resident memory in the first
and the last minute; prints frame rate, drops and the loop's latency beside it.
"""

import json
import time
from pathlib import Path
from statistics import mean
from typing import Any

import click
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from bench.machine import facts
from bench.options import JSON, Bench, on_graph
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.child import Sample
from pipeline.run.report import compose, tables
from pipeline.run.supervisor import Supervisor

WINDOW_S = 60.0
WARM_S = 10.0  # buffers and caches fill at first


@click.command(cls=Bench)
@on_graph
@click.option("--minutes", default=30.0, show_default=True, type=click.FloatRange(0.5))
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], minutes: float, path: Path | None
) -> None:
    """Let a graph run for long."""
    plan = load(graph, Overlay(source=source, changes=changes, clock="realtime"))
    with Supervisor(plan) as supervisor, Progress() as progress:
        supervisor.start()
        task = progress.add_task(f"{plan.name}, {minutes:g} min", total=minutes * 60)
        while (elapsed_s := time.monotonic() - supervisor.started_s) < minutes * 60:
            supervisor.tick()
            progress.update(task, completed=elapsed_s)
            if supervisor.failure:
                raise click.ClickException(supervisor.failure)
        samples = {name: supervisor.samples(name) for name in plan.processes()}
        supervisor.finish()
        supervisor.stop()
        report = compose(
            plan, supervisor.ledger, supervisor.summaries, samples, duration_s=elapsed_s,
            restarts=supervisor.restarts,
        )  # fmt: skip
    memory = {name: growth(found) for name, found in samples.items()}
    console = Console()
    console.print(tables(report))
    console.print(_table(memory))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        result = {"bench": "soak", **facts(), "minutes": minutes, "memory": memory, **report}
        path.write_text(json.dumps(result, indent=1))


def growth(samples: list[Sample]) -> dict[str, float]:
    """Mean resident megabytes in the first and in the last minute.

    >>> growth([Sample(t, 0, 50 + t / 1000) for t in (0, 20, 40, 2000)])
    {'first_mb': 50.0, 'last_mb': 52.0, 'grown_mb': 2.0}
    """
    start, end = samples[0].at_s + WARM_S, samples[-1].at_s
    first = mean(s.rss_mb for s in samples if start <= s.at_s <= start + WINDOW_S)
    last = mean(s.rss_mb for s in samples if s.at_s > end - WINDOW_S)
    return {"first_mb": round(first, 1), "last_mb": round(last, 1),
            "grown_mb": round(last - first, 1)}  # fmt: skip


def _table(memory: dict[str, dict[str, Any]]) -> Table:
    table = Table(title="resident memory, first and last minute")
    for column in ("process", "first MB", "last MB", "grown MB"):
        table.add_column(column, justify="right")
    for name, figures in memory.items():
        table.add_row(name, *(f"{value:.1f}" for value in figures.values()))
    return table


if __name__ == "__main__":
    main()
