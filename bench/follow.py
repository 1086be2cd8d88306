"""Measure how long the consumer follows its target: `python -m bench.follow --out FILE.json`.

Runs the tracking graph as processes in real time and sets another target class every minute, as
`fovea set` does. Prints and writes for every minute the IoU with the target's true box (0 in frames
without an answer), the share of that box inside the ROI, and the share of frames with an answer,
and compares the first ten minutes with the last ten. The file is written after every minute, so
that an interrupted run keeps its results.
"""

import json
import time
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from bench.machine import facts
from bench.options import Bench, file_name, on_graph, told_changes
from bench.overlap import FIGURES, Spans, ends, plot, watched
from pipeline.errors import RunError
from pipeline.extras import need
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.supervisor import Supervisor
from pipeline.whole_file import write_whole

LAST_WORDS_S = 3.0  # until the watcher has reported the last frames of a span


@click.command(cls=Bench)
@on_graph
@click.option("--minutes", default=60.0, show_default=True, type=click.FloatRange(0.1))
@click.option("--change-every-s", default=60.0, show_default=True, type=click.FloatRange(5))
@click.option("--targets", default="ball,referee", show_default=True, help="Classes, in turn.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="JSON.")
@click.option("--plot", "picture", type=click.Path(path_type=Path), help="PNG.")
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], minutes: float,
    change_every_s: float, targets: str, out: Path, picture: Path | None,
) -> None:  # fmt: skip
    """Run the graph for long and change its target regularly."""
    if picture:
        need("matplotlib", "--plot")
    names = targets.split(",")
    changes = (*changes, f"policy.target={names[0]}")
    plan = watched(load(graph, Overlay(source=source, changes=changes, clock="realtime")))
    options = plan.node("capture").settings.get("options", {})
    told = {
        "bench": "follow", **facts(), "graph": file_name(graph), "changes": told_changes(changes),
        "seed": options.get("seed"), "tracker": plan.node("tracker").operator,
        "minutes": minutes, "change_every_s": change_every_s,
    }  # fmt: skip
    for path in (out, picture):
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)
    with Supervisor(plan) as supervisor, Progress() as progress:
        task = progress.add_task(f"{plan.name}, {minutes:g} min", total=minutes * 60)
        supervisor.start()
        spans = Spans(supervisor)
        span, begun_s = 0, time.monotonic()
        spans.begin(0, names[0])
        while (elapsed_s := time.monotonic() - begun_s) < minutes * 60 + LAST_WORDS_S:
            supervisor.tick()
            if supervisor.failure:
                raise RunError(supervisor.failure)
            spans.read()
            progress.update(task, completed=elapsed_s)
            if elapsed_s >= (span + 1) * change_every_s:
                span += 1
                if elapsed_s < minutes * 60:
                    target = names[span % len(names)]
                    spans.begin(span, target)
                    spans.ask_for(target)
                write(told, spans.rows()[: span + 1], supervisor.restarts, out, picture)
        rows = [r for r in spans.rows() if r["span"] * change_every_s < minutes * 60]
        write(told, rows, supervisor.restarts, out, picture)
        supervisor.finish()
        supervisor.stop()
    Console().print(table(rows))


def write(
    told: dict[str, Any], rows: list[dict[str, Any]], restarts: dict[str, int], out: Path,
    picture: Path | None,
) -> None:  # fmt: skip
    """Write all results so far in one step, and their plot if there is a path for it."""
    found = {**told, "restarts": restarts, "ends": ends(rows), "rows": rows}
    write_whole(out, json.dumps(found, indent=1) + "\n")
    if picture and rows:
        plot(rows, picture, f"{told['graph']}, seed {told['seed']}")


def table(rows: list[dict[str, Any]]) -> Table:
    """Return the first ten minutes and the last ten as a table."""
    shown = Table(title="first ten minutes -> last ten: IoU, share in the ROI, share answered")
    for column in ("target", *FIGURES):
        shown.add_column(column)
    for target, parts in ends(rows).items():
        first, last = parts["first"], parts["last"]
        cells = (f"{first[n]:.3f} -> {last[n]:.3f}" if parts["grown"] else "" for n in FIGURES)
        shown.add_row(target, *cells)
    return shown


if __name__ == "__main__":
    main()
