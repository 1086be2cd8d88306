"""Compare variants of a graph in real time: `python -m bench.real_time GRAPH … [--each …]`.

Runs each graph of processes on drawn clips in real time, with each of the settings of `--each`, in
turns. Prints the share of the frames with the target in which it was inside the ROI, and over those
that were scored the tracker's IoU with it; both beside those of the first variant, paired by the
clip; and how late commands came. `bench.rules` runs graphs frame by frame instead, as if every
stage had the time that it needs; here a detector that is too slow misses frames.
"""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import click
from rich.console import Console
from rich.progress import Progress

from bench.machine import facts
from bench.options import JSON, Bench, file_name, told_changes
from bench.prototype import table
from bench.rules import FIRST_CLIP, worded
from bench.tracking.intervals import METHOD, Block, difference, mean
from pipeline.cli.running import processes
from pipeline.errors import RunError
from pipeline.file_arguments import GRAPH_FILE
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.report import Report
from pipeline.signals import Interruption

Variant = tuple[Path, str]  # a graph, and a setting of it or none


@click.command(cls=Bench)
@click.argument("graphs", nargs=-1, required=True, type=GRAPH_FILE)
@click.option(
    "--each",
    multiple=True,
    metavar="NODE.SETTING=VALUE",
    help="A variant of each graph; repeatable. Without: the graphs as they are.",
)
@click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE")
@click.option("--target", default="ball", show_default=True, help="As the truth calls it.")
@click.option("--clips", default=6, show_default=True, type=click.IntRange(1))
@click.option("--first-clip", default=FIRST_CLIP, show_default=True, type=click.IntRange(0))
@click.option("--frames", default=375, show_default=True, type=click.IntRange(10))
@JSON
def main(
    graphs: tuple[Path, ...], each: tuple[str, ...], changes: tuple[str, ...], target: str,
    clips: int, first_clip: int, frames: int, path: Path | None,
) -> None:  # fmt: skip
    """Compare variants of a graph in real time."""
    variants = [(graph, change) for graph in graphs for change in each or ("",)]
    names = [name_of(variant) for variant in variants]
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise RunError(f"expected variants of different names, got {twice[0]} twice")
    found: dict[str, dict[str, Report]] = {name: {} for name in names}
    console = Console(stderr=True)
    with Progress(console=console) as progress, Interruption() as asked:
        task = progress.add_task("starting", total=clips * len(variants))
        for turn, seed in enumerate(range(first_clip, first_clip + clips)):
            # what the machine does meanwhile shall not meet the same variant in every clip
            for variant in rotated(variants, turn):
                name = name_of(variant)
                progress.update(task, description=f"clip {seed}, {name}")
                laid = (*changes, f"capture.seed={seed}", f"score.label={target}")
                report = run(variant, laid, frames, asked)
                check(report, target, frames, f"clip {seed}, {name}")
                found[name][f"clip {seed}"] = report
                progress.advance(task)
    result = list(rows(found, target))
    Console().print(table(f"{target} in real time, {clips} x {frames} frames", result))
    if path:
        written = facts() | {
            "bench": "real_time", "graphs": [file_name(graph) for graph in graphs],
            "each": told_changes(each), "changes": told_changes(changes), "target": target,
            "seed": first_clip, "clips": clips, "frames": frames, "interval": METHOD,
            "rows": result,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(written, indent=1) + "\n")


def rotated(variants: Sequence[Variant], turn: int) -> Sequence[Variant]:
    """Return the variants in another order for each turn."""
    first = turn % len(variants)
    return [*variants[first:], *variants[:first]]


def name_of(variant: Variant) -> str:
    """Return what tells a variant from the others: its graph's file and its setting.

    >>> name_of((Path("/somewhere/mine.yaml"), "saliency.tiles=2"))
    'mine saliency.tiles=2'
    """
    graph, change = variant
    return " ".join([graph.stem, *told_changes([change] if change else [])])


def run(variant: Variant, changes: Sequence[str], frames: int, asked: Interruption) -> Report:
    """Run a variant on a clip; return its report."""
    graph, change = variant
    laid = (*changes, *([change] if change else []))
    plan = load(graph, Overlay(changes=laid, clock="realtime"))
    return processes(plan, frames, 0.0, Console(quiet=True), asked)


def check(report: Report, target: str, frames: int, where: str) -> None:
    """Raise `RunError` for a run that was cut short, or in which the target never was."""
    if failure := report.get("failure"):
        raise RunError(f"{where}: {failure}")
    if (exposed := report["frames"]["exposed"]) != frames:
        raise RunError(f"{where}: expected {frames} frames, got {exposed}")
    if not report["roi_coverage_frames"].get(target) or "iou" not in report:
        known = ", ".join(report["roi_coverage_frames"])
        raise RunError(f"{where}: expected a target of {known}, scored, got {target[:40]!r}")


def rows(found: Mapping[str, Mapping[str, Report]], target: str) -> Iterator[dict[str, Any]]:
    """Yield the figures of each variant over its clips, above the first of them."""
    first = next(iter(found.values()))
    usual = shares(first, target)
    for name, clips in found.items():
        row: dict[str, Any] = {"variant": name}
        for figure, own in shares(clips, target).items():
            row[figure] = round(mean(own).iou, 3)
            above = "" if clips is first else worded(*difference(own, usual[figure]))
            row[f"{figure}: above the first"] = above
        for figure, values in delays(clips.values()).items():
            row[figure] = spelled(values)
        scored = sum(report["iou"]["frames"] for report in clips.values())
        yield row | {"frames scored": scored, "clips": len(clips)}


def shares(clips: Mapping[str, Report], target: str) -> dict[str, dict[str, Block]]:
    """Return each clip's sum of the target's share in the ROI, and of the tracker's IoU."""
    present = {clip: report["roi_coverage_frames"][target] for clip, report in clips.items()}
    return {
        "share in the ROI": {
            clip: block(report["roi_coverage"][target], present[clip])
            for clip, report in clips.items()
        },
        "IoU": {
            clip: block(report["iou"]["mean"], report["iou"]["frames"])
            for clip, report in clips.items()
        },
    }


def block(middle: float, frames: int) -> Block:
    """Return one run's share of a mean."""
    return Block(total=middle * frames, frames=frames, starts=1)


def delays(reports: Iterable[Report]) -> dict[str, list[float]]:
    """Return p50 and p99 of picture ready -> command, and commands by frame, of each run."""
    kept = list(reports)
    latencies = [report["loop"]["latency_ms"] for report in kept]
    return {
        "loop p50 ms": [float(latency["p50"]) for latency in latencies],
        "loop p99 ms": [float(latency["p99"]) for latency in latencies],
        "share of frames planned": [
            report["loop"]["commands"] / report["frames"]["exposed"] for report in kept
        ],
    }


def spelled(values: Sequence[float]) -> str:
    """Return median, least and greatest.

    >>> spelled([30.0, 41.23, 28.5])
    '30 (28.5 .. 41.2)'
    """
    return f"{median(values):.3g} ({min(values):.3g} .. {max(values):.3g})"


if __name__ == "__main__":
    main()
