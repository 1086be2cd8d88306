"""Check for memory growth and degrading tracking: `python -m bench.soak [GRAPH] [--minutes 30]`.

Runs a graph of processes in real time and compares every process's resident memory in the first
and the last minute; also prints frame rate, drops and the loop's latency. For a tracking graph it
reports for every minute the IoU with the true box of the policy's target and the share of that box
inside the ROI, and compares the first ten minutes with the last ten.
"""

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import Any

import click
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from bench.machine import facts
from bench.options import JSON, Bench, on_graph
from bench.overlap import NEEDED, Spans, ends, watched
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.process_handle import Sample
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
    """Run a graph for long; compare memory and tracking at its beginning and end."""
    plan = load(graph, Overlay(source=source, changes=changes, clock="realtime"))
    tracks = {node.name for node in plan.nodes}.issuperset(NEEDED)
    plan = watched(plan) if tracks else plan
    with Supervisor(plan) as supervisor, Progress() as progress:
        supervisor.start()
        spans = Minutes(supervisor, plan.node("policy").settings) if tracks else None
        task = progress.add_task(f"{plan.name}, {minutes:g} min", total=minutes * 60)
        while (elapsed_s := time.monotonic() - supervisor.started_s) < minutes * 60:
            supervisor.tick()
            if spans:
                spans.attend(elapsed_s)
            progress.update(task, completed=elapsed_s)
            if supervisor.failure:
                raise click.ClickException(supervisor.failure)
        samples = {name: supervisor.samples(name) for name in plan.processes()}
        supervisor.finish()
        supervisor.stop()
        report = compose(
            plan, supervisor.ledger, supervisor.reports.summaries, samples, duration_s=elapsed_s,
            restarts=supervisor.restarts,
        )  # fmt: skip
    rows = spans.rows() if spans else []
    memory = {name: growth(found) for name, found in samples.items()}
    console = Console()
    console.print(tables(report))
    console.print(_table(memory))
    for line in faded(rows):
        console.print(line)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        result = {"bench": "soak", **facts(), "minutes": minutes, "memory": memory,
                  "overlap": {"ends": ends(rows), "rows": rows}, **report}  # fmt: skip
        path.write_text(json.dumps(result, indent=1))


class Minutes(Spans):
    """A span for each minute, of the class that the policy looks for."""

    def __init__(self, supervisor: Supervisor, policy: Mapping[str, Any]) -> None:
        super().__init__(supervisor)
        self._target, self._minute = str(policy.get("target") or "ball"), 0
        self.begin(0, self._target)

    def attend(self, elapsed_s: float) -> None:
        """Read new reports, and begin the next minute when it is due."""
        self.read()
        if elapsed_s >= (self._minute + 1) * WINDOW_S:
            self._minute += 1
            self.begin(self._minute, self._target)


def faded(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a line on the change of each figure; none without a truth."""
    told = ends(rows)["all"]
    if not told["grown"]:
        return []
    names = {"iou": "IoU", "shown": "share in the ROI", "answered": "share with an answer"}
    return [
        f"{words}, first ten minutes -> last ten: {told['first'][n]:.3f} -> {told['last'][n]:.3f}"
        for n, words in names.items()
    ]


def growth(samples: list[Sample]) -> dict[str, float]:
    """Return mean resident megabytes in the first and in the last minute, and the growth.

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
