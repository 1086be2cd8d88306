"""Measure the prototype's loop: `python -m bench.prototype [GRAPH] [--cycles 10] [--json FILE]`.

Runs the graph (graphs/prototype.yaml) as processes in real time, once for each target, until so
many bursts were recorded and downloaded; the first one, beside which the processes start, is left
out. Prints the frames between the newest context of a plan and the first frame that the plan
directs, by parts, and the share of every class inside the ROI, beside the paper's figures. The
parts: read-out and transfer of the context, the graph, and what remains: the command and the wait
for the next exposure.
"""

import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from bench.machine import facts
from bench.options import JSON, Bench, file_name
from bench.prototype_cycles import Cycle, cycles_of, node_file, read_lines, shares
from drivers.simulated.sources import open_scene
from drivers.source import FrameSource
from drivers.virtual_board.backend import VirtualBoardSettings
from pipeline.errors import RunError
from pipeline.file_arguments import GRAPH_FILE
from pipeline.graph.editing import with_nodes
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.run.supervisor import Supervisor
from pipeline.settings import build
from pipeline.whole_file import write_whole

PAPER = {"delay": 60.0, "readout": 28.7, "compute": 31.3}  # frames, supplement "Hardware Prototype"
MOST_S = 60.0  # of one cycle; more is an error
LOOK_S = 0.5  # between looks at what was recorded
PERIOD_MS = 1000 / 30


@click.command(cls=Bench)
@click.argument("graph", default="prototype", type=GRAPH_FILE)
@click.option("--cycles", default=10, show_default=True, type=click.IntRange(1, 1000))
@click.option("--targets", default="ball,referee,player", show_default=True, help="Classes.")
@click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE")
@JSON
def main(
    graph: Path, cycles: int, targets: str, changes: tuple[str, ...], path: Path | None
) -> None:
    """Measure the prototype's loop over record cycles."""
    console = Console()
    found: dict[str, list[Cycle]] = {}
    losses: dict[str, Any] = {}
    for target in targets.split(","):
        found[target], losses[target] = measured(graph, target, cycles, changes)
    settings = board_of(load(graph, Overlay(changes=changes, clock="lockstep")))
    world = world_of(settings)
    try:
        inside = {target: [shares(c, world) for c in runs] for target, runs in found.items()}
    finally:
        world.close()
    rows = delay_rows([cycle for runs in found.values() for cycle in runs])
    seen = share_rows(inside)
    console.print(table("delay of a plan, frames at 30 Hz", rows))
    console.print(table("share of the true boxes inside the ROI, over bursts", seen))
    if path:
        result = {
            "bench": "prototype", **facts(), "graph": file_name(graph), "changes": changes,
            "policy": load(graph).node("policy").operator, "seed": settings.seed,
            "cycles_per_target": cycles,
            "frames_per_burst": _spread([len(c.seqs) for runs in found.values() for c in runs]),
            "delay": rows, "shares": seen, "lost": losses,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(result, indent=1) + "\n")


def measured(
    graph: Path, target: str, count: int, changes: tuple[str, ...]
) -> tuple[list[Cycle], Any]:
    """Run the graph for so many cycles and one more before them.

    Return the cycles after the first, and what was lost on the edges.
    """
    with tempfile.TemporaryDirectory() as folder, Progress(transient=True) as shown:
        file = Path(folder) / "cycles.jsonl"
        overlay = Overlay(changes=(*changes, f"policy.target={target}"), clock="realtime")
        plan = load(graph, overlay)
        plan = with_nodes(plan, node_file(file))
        task = shown.add_task(f"{plan.name}: {target}", total=count)
        found: list[Cycle] = []
        with Supervisor(plan) as supervisor:
            supervisor.start()
            deadline_s = time.monotonic() + MOST_S * (count + 2)
            looked_s = 0.0
            while len(found) < count:
                supervisor.tick()
                now_s = time.monotonic()
                if supervisor.failure:
                    raise RunError(supervisor.failure)
                if now_s > deadline_s:
                    raise RunError(f"{plan.name}: expected {count} cycles, got {len(found)}")
                if now_s - looked_s > LOOK_S:
                    looked_s = now_s
                    found = cycles_of(read_lines(file))[1:]
                    shown.update(task, completed=len(found))
            supervisor.finish()
            supervisor.stop()
            dropped = {
                f"{e.origin} -> {e.end}": supervisor.ledger.edges[e.index].report()["dropped"]
                for e in plan.edges
            }
        lost = {edge: counts for edge, counts in dropped.items() if any(counts.values())}
        return found[:count], lost


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
        "command, until the next exposure": (rest, None),
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
