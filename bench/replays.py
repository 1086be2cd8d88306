"""Record, replay and compare: `python -m bench.replays [--seeds 10] [--footage FOLDER]`.

Records the graph learned in one thread and in lockstep, once for each seed of the drawn scene and
once on a clip of SoccerNet Tracking if there is one; runs the graph on each recording and compares
every message that it computes with the one recorded, bit for bit. Then the same light again: one
recording of full frames, on which the graph runs with other budgets and another target.
"""

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from bench.machine import facts
from bench.options import JSON, ROOT, Bench
from bench.results.markdown import table_of
from pipeline.cli.light import compared
from pipeline.cli.overlaid import load_overlaid
from pipeline.graph.shipped import source_path
from pipeline.recording.reader import Recording
from pipeline.run.replay import plan_in, record_inline, replay

GRAPH = ROOT / "graphs/learned.yaml"
RATE_HZ = 30.0
TRIES = (
    "capture.roi_area=0.0625", "capture.roi_area=0.03125", "capture.roi_area=0.015625",
    "capture.roi_area=0.0625 policy.target=referee",
)  # fmt: skip
Row = dict[str, Any]
NEVER: Callable[[], int] = lambda: 0  # noqa: E731 # nobody asks it to end


@click.command(cls=Bench, help=__doc__)
@click.option("--seeds", default=10, show_default=True, type=click.IntRange(1))
@click.option("--frames", default=60, show_default=True, type=click.IntRange(2))
@click.option("--footage", type=click.Path(path_type=Path, exists=True, file_okay=False))
@JSON
def main(seeds: int, frames: int, footage: Path | None, path: Path | None) -> None:
    """Record and replay each world, and run the tries."""
    worlds = {f"drawn, seed {seed}": laid(f"capture.seed={seed}") for seed in range(seeds)}
    if footage:
        worlds[footage.name] = laid(f"capture.path={footage}", source="soccernet")
    rows: list[Row] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()) as bar,
    ):
        task = bar.add_task("worlds", total=len(worlds) + 1)
        for name, changes in worlds.items():
            rows.append({"world": name, **again(changes, frames, Path(folder) / "seen.mcap")})
            bar.advance(task)
        tries = on_one_light(frames, Path(folder) / "light.mcap")
        bar.advance(task)
    result = {"bench": "replays", **facts(), "frames": frames, "n": len(rows), "rows": rows,
              "tries": tries}  # fmt: skip
    for table in (rows, [{"try": one, **found} for one, found in tries.items()]):
        click.echo(table_of(table))
    if path:
        path.write_text(json.dumps(result, indent=1) + "\n")


def laid(*changes: str, source: str = "") -> dict[str, Any]:
    """Return what is laid over the graph."""
    found = source_path(source) if source else None
    return {"source": found, "changes": changes, "clock": "lockstep", "wanted": ()}


def again(changes: dict[str, Any], frames: int, path: Path) -> Row:
    """Record a world, run the graph on it and compare; return what was found."""
    recorded = record_inline(load_overlaid(GRAPH, **changes), path, frames, NEVER)
    recording = Recording(path)
    found = replay(plan_in(recording), recording, verify=True)
    megabytes = path.stat().st_size / 1e6
    path.unlink()
    return {
        "frames": found.frames,
        "messages recorded": sum(one["recorded"] for one in recorded.values()),
        "compared": found.compared, "different": found.different,
        "megabytes": round(megabytes, 1),
        "times real time": round(found.frames / RATE_HZ / found.duration_s, 2),
    }  # fmt: skip


def on_one_light(frames: int, path: Path) -> dict[str, Row]:
    """Return by try what it shows of one recording of full frames."""
    plan = load_overlaid(GRAPH, **laid("capture.strategy=full"))
    record_inline(plan, path, frames, NEVER)
    reports = compared(path, GRAPH, TRIES, 0, NEVER, laid())
    return {one: figures(report) for one, report in reports.items()}


def figures(report: Any) -> Row:
    """Return the pixels read, what of the objects was inside the ROI, and the IoU of a report."""
    inside, iou = report["roi_coverage"], report["iou"]
    return {
        "share of the pixels read": report["pixels"]["used"],
        "ball inside the ROI": round(inside["ball"], 3),
        "referee inside the ROI": round(inside["main referee"], 3),
        "IoU of the target": iou["mean"], "answered": iou["answered"],
    }  # fmt: skip


if __name__ == "__main__":
    main()
