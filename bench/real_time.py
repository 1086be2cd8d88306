"""Compare variants of a graph in real time: `python -m bench.real_time [GRAPH …] [--each …]`.

Runs each graph of processes on drawn clips in real time, with each of the settings of `--each`, in
turns. Prints how often the target was inside the ROI, the IoU of the tracker with it, over all
frames in which the target is visible, both beside those of the first variant and paired by the
clip, and how late commands came. `bench.rules` runs graphs frame by frame instead, as if every
stage had the time that it needs; here a detector that is too slow misses frames.
"""

import json
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

SHARES = ("share in the ROI", "IoU")
DELAYS = ("loop p50 ms", "loop p99 ms", "share of frames planned")
Variant = tuple[Path, str]  # a graph, and a setting of it or none


@click.command(cls=Bench)
@click.argument("graphs", nargs=-1, type=GRAPH_FILE)
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
    if not graphs:
        raise click.UsageError("expected a graph, got none")
    variants = [(graph, change) for graph in graphs for change in each or ("",)]
    found: dict[Variant, dict[str, Report]] = {variant: {} for variant in variants}
    console = Console(stderr=True)
    with Progress(console=console) as progress:
        task = progress.add_task("starting", total=clips * len(variants))
        for turn, seed in enumerate(range(first_clip, first_clip + clips)):
            # what the machine does meanwhile shall not meet the same variant in every clip
            for variant in rotated(variants, turn):
                progress.update(task, description=f"clip {seed}, {name_of(variant)}")
                found[variant][f"clip {seed}"] = run(variant, changes, seed, frames)
                progress.advance(task)
    result = list(rows(found, target))
    Console().print(table(f"{target} in real time, {clips} x {frames} frames", result))
    if path:
        report = facts() | {
            "bench": "real_time", "graphs": [file_name(graph) for graph in graphs],
            "each": list(each), "changes": told_changes(changes), "target": target,
            "seed": first_clip, "clips": clips, "frames": frames, "interval": METHOD,
            "rows": result,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(report, indent=1) + "\n")


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
    return f"{graph.stem} {change}".strip()


def run(variant: Variant, changes: Sequence[str], seed: int, frames: int) -> Report:
    """Run a variant on a clip; return its report."""
    graph, change = variant
    laid = (*changes, f"capture.seed={seed}", *([change] if change else []))
    plan = load(graph, Overlay(changes=laid, clock="realtime"))
    return processes(plan, frames, 0.0, Console(quiet=True))


def rows(found: Mapping[Variant, Mapping[str, Report]], target: str) -> Iterator[dict[str, Any]]:
    """Yield the figures of each variant over its clips, above the first of them."""
    first = next(iter(found.values()))
    usual = dict(zip(SHARES, shares(first, target), strict=True))
    for variant, clips in found.items():
        row: dict[str, Any] = {"variant": name_of(variant)}
        for figure, own in zip(SHARES, shares(clips, target), strict=True):
            row[figure] = round(mean(own).iou, 3)
            above = "" if clips is first else worded(*difference(own, usual[figure]))
            row[f"{figure}: above the first"] = above
        for name, values in zip(DELAYS, delays(clips.values()), strict=True):
            row[name] = spelled(values)
        yield row | {"clips": len(clips)}


def shares(clips: Mapping[str, Report], target: str) -> tuple[dict[str, Block], dict[str, Block]]:
    """Return each clip's sum of the target's share in the ROI, and of the tracker's IoU."""
    inside, overlap = {}, {}
    for clip, report in clips.items():
        visible = report["roi_coverage_frames"]
        if target not in visible:
            known = ", ".join(visible)
            raise RunError(f"--target: expected one of {known} ({clip}), got {target[:40]!r}")
        inside[clip] = block(report["roi_coverage"][target], visible[target])
        if "iou" not in report:
            raise RunError(f"{clip}: expected a graph with operators.score:Score, got none")
        overlap[clip] = block(report["iou"]["mean"], report["iou"]["frames"])
    return inside, overlap


def block(middle: float, frames: int) -> Block:
    """Return one run's share of a mean."""
    return Block(total=middle * frames, frames=frames, starts=1)


def delays(reports: Iterable[Report]) -> Iterator[list[float]]:
    """Yield p50 and p99 of picture ready -> command, and commands by frame, of each run."""
    kept = list(reports)
    for share in ("p50", "p99"):
        yield [float(report["loop"]["latency_ms"][share]) for report in kept]
    yield [report["loop"]["commands"] / max(1, report["frames"]["exposed"]) for report in kept]


def spelled(values: Sequence[float]) -> str:
    """Return median, least and greatest.

    >>> spelled([30.0, 41.23, 28.5])
    '30 (28.5 .. 41.2)'
    """
    return f"{median(values):.3g} ({min(values):.3g} .. {max(values):.3g})"


if __name__ == "__main__":
    main()
