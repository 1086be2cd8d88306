"""What `fovea tune` changes: `python -m bench.tuned tracking whole_pitch [--set …] [--json FILE]`.

Tunes each graph on this machine, then runs it in real time as it is and as proposed, in turn, a
pair a round; the ratio is that of a pair. Where nothing is proposed, nothing is run. With `--set`
the graph begins with other settings than the shipped ones.
"""

import json
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from bench.loop import spread
from bench.machine import facts
from bench.options import JSON, Bench, file_name
from bench.results.markdown import table_of
from pipeline.cli.running import processes
from pipeline.cli.tune import MOST_THREADS, changes_of, measured, rate_of
from pipeline.cores import available_cores
from pipeline.file_arguments import GRAPH_FILE
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.report import Report

TRIED = 40  # frames of a measurement of `fovea tune`
Row = dict[str, Any]


@click.command(cls=Bench, help=__doc__)
@click.argument("graphs", nargs=-1, required=True, type=GRAPH_FILE)
@click.option("--set", "begun", multiple=True, metavar="NODE.SETTING=VALUE")
@click.option("--frames", default=240, show_default=True, type=click.IntRange(10))
@click.option("--rounds", default=3, show_default=True, type=click.IntRange(1))
@JSON
def main(
    graphs: tuple[Path, ...], begun: tuple[str, ...], frames: int, rounds: int, path: Path | None
) -> None:
    """Tune each graph and run it before and after."""
    console, rows = Console(), list[Row]()
    most = min(MOST_THREADS, int(available_cores()))
    for graph in graphs:
        plan = load(graph, Overlay(changes=begun))
        proposed = changes_of(measured(plan, rate_of(plan), TRIED, most)[0])
        changes = tuple(f"{n}.{k}={v}" for n, s in proposed.items() for k, v in s.items())
        row: Row = {
            "graph": file_name(graph), "begun with": ", ".join(begun),
            "proposed": ", ".join(changes),
        }  # fmt: skip
        if changes:
            row |= compared(graph, begun, (*begun, *changes), frames, rounds, console)
        rows.append(row)
        rows.sort(key=len, reverse=True)  # the first one names the columns
        result = {"bench": "tuned", **facts(), "frames": frames, "n": rounds, "rows": rows}
        if path:
            path.write_text(json.dumps(result, indent=1) + "\n")
    click.echo(table_of(rows))


def compared(
    graph: Path, begun: tuple[str, ...], changes: tuple[str, ...], frames: int, rounds: int,
    console: Console,
) -> Row:  # fmt: skip
    """Return figures of both, and their ratio in pairs."""
    pairs = []
    for number in range(rounds):
        console.print(f"{graph.stem}: round {number + 1} of {rounds}")
        both = (begun, changes) if number % 2 == 0 else (changes, begun)
        found = {
            each: figures(
                processes(load(graph, Overlay(None, each, "realtime")), frames, 0.0, console)
            )
            for each in both
        }
        pairs.append((found[begun], found[changes]))
    row: Row = {}
    for name in pairs[0][0]:
        for which, values in (
            ("before", [before[name] for before, _ in pairs]),
            ("after", [after[name] for _, after in pairs]),
            ("ratio", [after[name] / before[name] for before, after in pairs if before[name]]),
        ):
            row[f"{name} {which}"] = told(values) if values else None
    return row


def figures(report: Report) -> dict[str, float]:
    """Return latency, processor time, rate and drops of a run.

    >>> figures({"loop": {"latency_ms": {"p50": 5, "p99": 9}}, "stages": [{"cpu_percent": 4}],
    ...          "edges": [{"dropped": {"stale": 2}}]})
    {'p50 ms': 5.0, 'p99 ms': 9.0, 'cpu percent': 4.0, 'dropped': 2.0}
    """
    latency_ms = report["loop"]["latency_ms"]
    return {
        "p50 ms": float(latency_ms["p50"]), "p99 ms": float(latency_ms["p99"]),
        "cpu percent": float(sum(stage["cpu_percent"] for stage in report["stages"])),
        "dropped": float(sum(sum(e["dropped"].values()) for e in report["edges"])),
    }  # fmt: skip


def told(values: list[float]) -> str:
    """Return median and range.

    >>> told([1.0, 3.0, 2.0])
    '2 (1 to 3)'
    """
    found = spread(values)
    return f"{found['median']:.4g} ({found['min']:.4g} to {found['max']:.4g})"


if __name__ == "__main__":
    main()
