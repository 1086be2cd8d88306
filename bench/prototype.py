"""Measure the prototype's loop: `python -m bench.prototype [GRAPH] [--cycles 10] [--json FILE]`.

Runs the graph (graphs/prototype.yaml) as processes in real time, once for each target, until so
many bursts were recorded and downloaded; the first one, beside which the processes start, is left
out. Prints the frames between the newest context of a plan and the first frame that the plan
directs, by parts, and the share of every class inside the ROI, beside the paper's figures. The
parts: read-out and transfer of the context, the graph, and what remains: the command and the wait
for the exposure that obeys it.

Every object has rows of its own: its share in the bursts that follow its class, and with `--each N`
in N bursts that follow itself, prompted by its box (bench/prototype_objects.py).
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from bench.machine import facts
from bench.options import JSON, Bench, file_name, told_changes
from bench.prototype_cycles import Cycle, shares
from bench.prototype_objects import Prompter, class_rows, objects_of, prompt_rows
from bench.prototype_run import Measured, measured
from drivers.simulated.sources import open_scene
from drivers.source import FrameSource
from drivers.virtual_board.backend import VirtualBoardSettings
from pipeline.errors import RunError
from pipeline.file_arguments import GRAPH_FILE
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.settings import build
from pipeline.whole_file import write_whole

PAPER = {"delay": 60.0, "readout": 28.7, "compute": 31.3}  # frames, supplement "Hardware Prototype"
PERIOD_MS = 1000 / 30
EACH = "each object"
TITLES = {
    "delay": "delay of a plan, frames at 30 Hz",
    "shares": "share of the true boxes inside the ROI, over bursts",
    "objects": "each object one by one: its share in bursts that follow its class",
    "prompted": "each object as the target, prompted by its box: its share",
}


@click.command(cls=Bench)
@click.argument("graph", default="prototype", type=GRAPH_FILE)
@click.option("--cycles", default=10, show_default=True, type=click.IntRange(1, 1000))
@click.option("--targets", default="ball,referee,player", show_default=True, help="Classes.")
@click.option(
    "--each", default=0, show_default=True, type=click.IntRange(0, 100),
    help="Bursts of every object of the world as the target, prompted by its box.",
)  # fmt: skip
@click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE")
@JSON
def main(
    graph: Path, cycles: int, targets: str, each: int, changes: tuple[str, ...], path: Path | None
) -> None:
    """Measure the prototype's loop over record cycles."""
    settings = board_of(load(graph, Overlay(changes=changes, clock="lockstep")))
    found: dict[str, Measured] = {}
    for target in targets.split(","):
        wanted = (*changes, f"policy.target={target}")
        found[target] = measured(graph, wanted, cycles, title=target)
    world = world_of(settings)
    try:
        inside = {
            target: [shares(cycle, world) for cycle in run.cycles] for target, run in found.items()
        }
        tables = {"objects": class_rows(inside)}
        if each:
            found[EACH], tables["prompted"] = each_object(graph, changes, world, each)
    finally:
        world.close()
    rows = delay_rows([cycle for run in found.values() for cycle in run.cycles])
    tables = {"delay": rows, "shares": share_rows(inside), **tables}
    console = Console()
    for name, kept in tables.items():
        console.print(table(TITLES[name], kept))
    if path:
        result = {
            "bench": "prototype", **facts(), "graph": file_name(graph),
            "changes": told_changes(changes),
            "policy": load(graph).node("policy").operator, "profile": settings.profile,
            "seed": settings.seed, "cycles_per_target": cycles, "bursts_per_prompt": each,
            "frames_per_burst": _spread([len(c.seqs) for r in found.values() for c in r.cycles]),
            **tables, "lost": {target: run.lost for target, run in found.items()},
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(result, indent=1) + "\n")


def each_object(
    graph: Path, changes: tuple[str, ...], world: FrameSource, each: int
) -> tuple[Measured, list[dict[str, Any]]]:
    """Follow every object of the world in turn; return the run and a row for each object."""
    prompter = Prompter(world=world, objects=sorted(objects_of(world)), each=each)
    wanted = (*changes, "policy.target=")
    count = each * len(prompter.objects)
    run = measured(graph, wanted, count, title=EACH, watch=prompter.watch)
    return run, prompt_rows(prompter, run.cycles, world)


def board_of(plan: Plan) -> VirtualBoardSettings:
    """Return what the virtual board of a plan looks at; raises `RunError` without one."""
    options = plan.node("capture").settings.get("options", {})
    if "backend_options" not in options:
        raise RunError(f"{plan.name}: expected a virtual board, whose world is known, got another")
    return build(VirtualBoardSettings, options["backend_options"], "backend_options")


def world_of(settings: VirtualBoardSettings) -> FrameSource:
    """Open what the board looks at, for its truth."""
    can = settings.scaled().can
    return open_scene(
        settings.scene, size_px=(can.width_px, can.height_px), rate_hz=0.0, seed=settings.seed,
        length=settings.frames or None, options=settings.source_options,
    )  # fmt: skip


def delay_rows(cycles: Sequence[Cycle]) -> list[dict[str, Any]]:
    """Return median, least and greatest of the delay and its parts, beside the paper's."""
    readout = [c.readout_ms / PERIOD_MS for c in cycles]
    compute = [c.compute_ms / PERIOD_MS for c in cycles]
    whole = [float(c.delay_frames) for c in cycles]
    rest = [w - r - c for w, r, c in zip(whole, readout, compute, strict=True)]
    parts = {
        "read-out and transfer of the context": (readout, PAPER["readout"]),
        "the graph": (compute, PAPER["compute"]),
        "command, until the exposure that obeys it": (rest, None),
        "the plan's newest context to the first frame that it directs": (whole, PAPER["delay"]),
    }
    return [
        {"part": part, **_spread(values), "paper": paper} for part, (values, paper) in parts.items()
    ]


def share_rows(inside: Mapping[str, Sequence[Mapping[str, float]]]) -> list[dict[str, Any]]:
    """Return the mean share of each class over the cycles of each target.

    Of several objects of the target's class, `itself` is the one that each burst showed most; its
    median, least and greatest are over cycles.
    """
    rows = []
    for target, cycles in inside.items():
        classes = sorted({name for cycle in cycles for name in cycle if " " not in name})
        means = {name: round(float(np.mean([c[name] for c in cycles])), 3) for name in classes}
        best = [max(s for n, s in c.items() if n.startswith(f"{target} ")) for c in cycles]
        itself = {f"itself, {name}": value for name, value in _spread(best).items()}
        rows.append({"target": target, **means, **itself, "cycles": len(cycles)})
    return rows


def _spread(values: Sequence[float]) -> dict[str, float]:
    """Return median, least and greatest.

    >>> _spread([3, 1, 2])
    {'median': 2.0, 'min': 1.0, 'max': 3.0}
    """
    low, middle, high = np.quantile(values, [0, 0.5, 1]).round(3).tolist()
    return {"median": middle, "min": low, "max": high}


def table(title: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return rows of equal keys as a table."""
    shown = Table(title=title)
    for name in rows[0]:
        shown.add_column(name)
    for row in rows:
        shown.add_row(*(_cell(value) for value in row.values()))
    return shown


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
