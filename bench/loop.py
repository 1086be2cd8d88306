"""Measure the latency of the loop: `python -m bench.loop [GRAPH] [--source …] [--json FILE]`.

Runs a graph of processes in real time, several rounds; prints picture ready -> command accepted,
each stage's share, what remains beyond the handlers' own time, drops, memory and processor time.
"""

import json
from collections.abc import Collection
from pathlib import Path
from statistics import median
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from bench.machine import facts
from bench.options import JSON, Bench, file_name, on_graph, told_changes
from pipeline.cli.running import processes
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.report import Report

FRAME_BUDGET_MS = (33.0, 66.0)  # limits of the loop's p50 and p99: one and two frames at 30 fps
OVERHEAD_MS = 3.0


@click.command(cls=Bench)
@on_graph
@click.option("--frames", default=375, show_default=True, type=click.IntRange(10))
@click.option("--rounds", default=3, show_default=True, type=click.IntRange(1))
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], frames: int, rounds: int,
    path: Path | None,
) -> None:  # fmt: skip
    """Measure the loop of a graph."""
    console = Console()
    plan = load(graph, Overlay(source=source, changes=changes, clock="realtime"))
    reports = []
    for number in range(rounds):
        console.print(f"round {number + 1} of {rounds}")
        reports.append(processes(plan, frames, 0.0, console))
    result = {"bench": "loop", **facts(), "graph": file_name(graph),
              "source": file_name(source) if source else "", "changes": told_changes(changes),
              "frames": frames, "summary": summarise(reports, plan.command_path()),
              "rounds": reports}  # fmt: skip
    console.print(table(result["summary"]))
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1))


def summarise(reports: list[Report], path: Collection[str]) -> dict[str, Any]:
    """Return each figure's median over the rounds, with the least and the greatest value."""
    loop = {
        f"{name}_{share}": spread([r["loop"][name][share] for r in reports])
        for name in ("latency_ms", "overhead_ms", "scheduling_delay_ms")
        for share in ("p50", "p99")
    }
    stages = {
        stage["node"]: {
            key: spread([_figure(r["stages"][i], key) for r in reports])
            for key in ("handler_p50_ms", "hop_p50_ms", "cpu_percent", "rss_mb")
        }
        for i, stage in enumerate(reports[0]["stages"])
    }
    drops = {
        f"{edge['from']} -> {edge['to']}": [r["edges"][i]["dropped"] for r in reports]
        for i, edge in enumerate(reports[0]["edges"])
    }
    return {"loop": loop, "stages": stages, "drops": drops,
            "sum_of_handlers_ms": spread([_handlers(r, path) for r in reports])}  # fmt: skip


def spread(values: list[float]) -> dict[str, float]:
    """Return median, least and greatest value.

    >>> spread([3.0, 1.0, 2.0])
    {'median': 2.0, 'min': 1.0, 'max': 3.0}
    """
    return {"median": median(values), "min": min(values), "max": max(values)}


def table(summary: dict[str, Any]) -> Table:
    """Return the figures as a table, with their limits."""
    shown = Table(title="loop: picture ready -> command accepted by the sensor")
    for column in ("figure", "median", "min .. max", "asked"):
        shown.add_column(column)
    asked = {
        "latency_ms_p50": f"<= {FRAME_BUDGET_MS[0]:.0f}",
        "latency_ms_p99": f"<= {FRAME_BUDGET_MS[1]:.0f}",
        "overhead_ms_p50": f"<= {OVERHEAD_MS:.0f}",
    }
    rows = {**summary["loop"], "sum_of_handlers_ms": summary["sum_of_handlers_ms"]}
    for stage, figures in summary["stages"].items():
        rows |= {f"{stage} {key}": value for key, value in figures.items()}
    for name, value in rows.items():
        shown.add_row(
            name, f"{value['median']:.2f}", f"{value['min']:.2f} .. {value['max']:.2f}",
            asked.get(name, ""),
        )  # fmt: skip
    for edge, drops in summary["drops"].items():
        if any(drops):
            shown.add_row(f"drops {edge}", str(drops), "", "")
    return shown


def _figure(stage: dict[str, Any], key: str) -> float:
    if key == "handler_p50_ms":
        return float(stage["latency_ms"]["p50"])
    if key == "hop_p50_ms":
        return float(stage["hop_ms"]["p50"])
    return float(stage[key])


def _handlers(report: Report, path: Collection[str]) -> float:
    """Return the sum of the median handler times of the stages between picture and command."""
    return float(sum(s["latency_ms"]["p50"] for s in report["stages"] if s["node"] in path))


if __name__ == "__main__":
    main()
