"""Run a graph several times on the same recorded light, and compare the runs in a table."""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.text import Text

from pipeline.cli.overlaid import load_overlaid
from pipeline.errors import RunError
from pipeline.graph.plan import Plan, sources
from pipeline.graph.shipped import source_path
from pipeline.import_path import imported
from pipeline.run.inline import InlineRunner
from pipeline.run.replay import sentences
from pipeline.run.report import Report
from pipeline.terminal import lean_table

WRITE_BESIDE = "operators.visualise.beside:write_beside"  # by its path: no import of an operator
CHECK_COLUMNS = "operators.visualise.beside:columns"
SOURCE = "recording"  # the shipped source that plays a recording's frames
MOST_FIGURES = 24
OTHER = {  # of a report: of this host and of the runtime, not of the light
    "duration_s", "edges", "stages", "restarts", "crashes", "rate", "loop", "verdict", "frames",
}  # fmt: skip


def compared(
    file: Path, graph: Path, tries: Sequence[str], frames: int, asked: Callable[[], int],
    laid: Mapping[str, Any], save: Path | None = None,
) -> dict[str, Report]:  # fmt: skip
    """Run the graph on a recording's frames, once for each try; return the reports.

    `save`: also write them side by side as a Rerun recording.

    A try is `NODE.SETTING=VALUE …`, laid over the other changes; an empty one is the graph as it
    is. Every graph is checked before the first one runs.
    """
    with tempfile.TemporaryDirectory() as folder:
        parts: dict[str, Path] = {}  # recordings
        plans = {}
        name = next(sources(load_overlaid(graph, **laid))).name
        for one in dict.fromkeys(tries) or ("",):
            changes = (*laid["changes"], f"{name}.path={file.absolute()}", *one.split())
            over = {"source": source_path(SOURCE), "changes": changes, "clock": "lockstep"}
            label = one or "as it is"
            if save:
                over["save"] = parts[label] = Path(folder) / f"{len(parts)}.rrd"
            plans[label] = load_overlaid(graph, **{**laid, **over})
        if save:  # too many are refused before anything runs
            imported(CHECK_COLUMNS, RunError)(tuple(plans))
        found = _run(plans, frames, asked)
        if save:
            imported(WRITE_BESIDE, RunError)({label: parts[label] for label in found}, save)
    return found


def _run(
    plans: Mapping[str, Plan], frames: int, asked: Callable[[], int]
) -> dict[str, Report]:  # fmt: skip
    found = {}
    for label, plan in plans.items():
        runner = InlineRunner(plan)
        with sentences(runner), runner:
            for _seq in runner.run(frames):
                if asked():
                    break
            found[label] = runner.report()
        if asked():
            break
    return found


def table(reports: Mapping[str, Report]) -> Group:
    """Return the figures of the nodes that differ between the runs: a line each, a run a column.

    Above it stands which run has which number.
    """
    figures = {label: dict(_figures(report)) for label, report in reports.items()}
    names = list(dict.fromkeys(name for one in figures.values() for name in one))
    differing = [n for n in names if len({one.get(n) for one in figures.values()}) > 1]
    runs = [str(number) for number in range(1, len(figures) + 1)]
    said = [f"{number}: {label}" for number, label in zip(runs, figures, strict=True)]
    made = lean_table(names=("figure",), figures=runs)
    for name in (differing or names)[:MOST_FIGURES]:
        values = [f"{one[name]:g}" if name in one else "" for one in figures.values()]
        made.add_row(name, *values)
    return Group(*map(Text, said), made)


def _figures(value: Any, where: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of nested mappings: `iou.mean`, 0.4 …"""
    if isinstance(value, Mapping):
        for name, part in value.items():
            if where or name not in OTHER:
                yield from _figures(part, f"{where}.{name}" if where else str(name))
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield where, value
