"""The paper's Table 1 from reports of all tasks, for `python -m bench.tables --only all-tasks`.

Takes what `fovea eval tracking`, `text` and `manipulation` wrote with `--report`, one or more of
them, or a table of strategies of `bench/results`, and writes a table as a result file
(`all_tasks.json`) and as Markdown, with the paper's figures beside ours, and one plot of all
budgets. The data are not the paper's: its footage, its
street videos and its robot's demonstrations are others, so that rows are to be compared by what the
strategies keep of full resolution.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from bench.outputs import write_figure
from bench.tracking.plots import looks
from pipeline.errors import SettingsError
from pipeline.extras import need
from pipeline.whole_file import write_whole

NAME = "all_tasks"
STRATEGIES = (
    *("full", "oracle", "foveated", "spatial", "temporal", "exposure", "context", "centred"),
    "round_robin",
)
PAPER = {  # Table 1, the budget sweep and the ablations; full resolution at every budget
    ("ball: IoU", "full"): 0.281, ("ball: IoU", "oracle", "1/8"): 0.405,
    ("ball: IoU", "foveated", "1/4"): 0.287, ("ball: IoU", "foveated", "1/8"): 0.283,
    ("ball: IoU", "foveated", "1/16"): 0.276, ("ball: IoU", "spatial", "1/4"): 0.212,
    ("ball: IoU", "spatial", "1/8"): 0.122, ("ball: IoU", "spatial", "1/16"): 0.048,
    ("ball: IoU", "temporal", "1/4"): 0.159, ("ball: IoU", "temporal", "1/8"): 0.148,
    ("ball: IoU", "temporal", "1/16"): 0.144, ("ball: IoU", "exposure", "1/8"): 0.098,
    ("text: share read", "full"): 0.333, ("text: share read", "oracle", "1/8"): 0.271,
    ("text: share read", "foveated", "1/4"): 0.290, ("text: share read", "foveated", "1/8"): 0.264,
    ("text: share read", "foveated", "1/16"): 0.227, ("text: share read", "spatial", "1/4"): 0.146,
    ("text: share read", "spatial", "1/8"): 0.067, ("text: share read", "spatial", "1/16"): 0.023,
    ("text: share read", "temporal", "1/4"): 0.283, ("text: share read", "temporal", "1/8"): 0.248,
    ("text: share read", "temporal", "1/16"): 0.173, ("text: share read", "exposure", "1/8"): 0.071,
    ("insertion: complete", "full"): 0.15, ("insertion: complete", "foveated", "1/8"): 0.13,
    ("insertion: complete", "foveated", "1/16"): 0.12,
    ("insertion: complete", "foveated", "1/32"): 0.04,
    ("insertion: complete", "spatial", "1/8"): 0.12,
    ("insertion: complete", "spatial", "1/16"): 0.10,
    ("insertion: complete", "spatial", "1/32"): 0.04,
    ("insertion: complete", "temporal", "1/8"): 0.08,
    ("insertion: complete", "temporal", "1/16"): 0.07,
    ("insertion: complete", "temporal", "1/32"): 0.02,
    ("insertion: complete", "exposure", "1/16"): 0.0,
}  # fmt: skip
PLAIN = {"pursuit": "foveated", "foveated pursuit": "foveated"}  # the rule that ships


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One figure: a measure of a task by a strategy at a budget."""

    measure: str
    strategy: str
    budget: str
    value: float


def write_table(given: Mapping[str, Path], target: str, out: Path) -> None:
    """Put the reports of tasks, by the task's name, into one table and one plot in a folder.

    Raises `SettingsError` for files that are no reports of these tasks.
    """
    reports = {task: read_report(path) for task, path in given.items()}
    cells = [cell for task, report in reports.items() for cell in cells_of(task, report, target)]
    picture = out / f"{NAME}.png"
    plot(cells, picture)
    found = table_of(cells, reports, picture.name)
    write_whole(out / f"{NAME}.json", json.dumps(found, indent=1, ensure_ascii=False) + os.linesep)
    write_whole(out / f"{NAME}.md", markdown_of(found))


def read_report(path: Path) -> dict[str, Any]:
    """Return a report, or a table as one; raises `SettingsError` for another file."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SettingsError(f"{path}: expected a report of fovea eval: {error}") from error
    if isinstance(found, dict) and isinstance(found.get("columns"), list):
        try:
            found = found | {"rows": rows_of_table(found["columns"], found.get("rows"))}
        except (AttributeError, TypeError, ValueError) as error:
            raise SettingsError(f"{path}: expected a table of strategies: {error}") from error
    rows = found.get("rows") if isinstance(found, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise SettingsError(f"{path}: expected a report of fovea eval with rows")
    return dict(found)


def rows_of_table(columns: list[Any], rows: Any) -> list[dict[str, Any]] | None:
    """Return a table of targets, budgets and strategies as rows of a report; None for another.

    The first figure of a cell is the IoU; bold, and what stands in brackets behind a name, is left
    out.

    >>> rows_of_table(["target", "budget", "pursuit (ships)"], [["ball", "1/16", "**.66**, .98"]])
    [{'clip': 'all', 'target': 'ball', 'strategy': 'pursuit', 'budget': '1/16', 'iou': 0.66}]
    """
    if columns[:2] != ["target", "budget"] or not isinstance(rows, list):
        return None
    found = []
    for target, budget, *cells in rows:
        for column, cell in zip(columns[2:], cells, strict=True):
            strategy = column.partition(" (")[0].replace(" ", "_")
            iou = _figure(cell)
            at = "1" if strategy == "full" else budget
            told = {"clip": "all", "target": target, "strategy": strategy, "budget": at, "iou": iou}
            found.append(told)
    return found


def _figure(cell: str) -> float | None:
    text = cell.partition(",")[0].strip("*")
    return float(text) if text else None


def cells_of(task: str, report: Mapping[str, Any], target: str) -> list[Cell]:
    """Return the figures of a report; raises `SettingsError` where its rows are of another task."""
    read = {"tracking": _of_tracking, "text": _of_text, "manipulation": _of_manipulation}[task]
    try:
        found = [cell for row in report["rows"] for cell in read(row, target)]
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:  # such as a budget of 1/0
        raise SettingsError(f"--{task}: expected rows of that task, got {error!r}") from error
    if not found:
        raise SettingsError(f"--{task}: expected rows of {target}, got none")
    return found


def _of_tracking(row: Mapping[str, Any], target: str) -> list[Cell]:
    clips_together = row["clip"] == "all" or row["clips"] > 1
    if row["target"] != target or not clips_together or row["iou"] is None:
        return []
    strategy = PLAIN.get(row["strategy"], row["strategy"])
    if strategy not in STRATEGIES:
        return []
    return [_cell(f"{target}: IoU", strategy, row["budget"], row["iou"])]


def _of_text(row: Mapping[str, Any], _: str) -> list[Cell]:
    if row["strategy"] not in STRATEGIES:
        return []
    return [_cell("text: share read", row["strategy"], row["budget"], row["read"])]


def _of_manipulation(row: Mapping[str, Any], _: str) -> list[Cell]:
    if row["strategy"] not in STRATEGIES:
        return []
    return [
        _cell(f"insertion: {name}", row["strategy"], row["budget"], row[name]["share"])
        for name in ("complete", "partial")
    ]


def _cell(measure: str, strategy: str, budget: str, value: float) -> Cell:
    Fraction(budget)  # raises ValueError for anything else
    return Cell(measure=measure, strategy=strategy, budget=str(budget), value=float(value))


def table_of(
    cells: Sequence[Cell], reports: Mapping[str, Mapping[str, Any]], picture: str
) -> dict[str, Any]:
    """Return the table as a result file; behind `|`, the paper's figure where it has one."""
    by_place = {(c.measure, c.strategy, c.budget): c.value for c in cells}
    rows = []
    for measure in dict.fromkeys(cell.measure for cell in cells):
        budgets = {c.budget for c in cells if c.measure == measure and c.strategy != "full"}
        for budget in sorted(budgets, key=Fraction, reverse=True):
            row: list[str] = [measure, budget]
            for strategy in STRATEGIES:
                at = "1" if strategy == "full" else budget
                row.append(_told(by_place.get((measure, strategy, at)), measure, strategy, budget))
            rows.append(row)
    commits = {str(report.get("commit", ""))[:7] for report in reports.values()} - {""}
    data = "; ".join(f"{task}: {_data(report)}" for task, report in reports.items())
    return {
        "id": NAME,
        "section": "All tasks",
        "order": 1,
        "title": "All tasks beside the paper's Table 1: ours | the paper's",
        "source": "python -m bench.tables",
        "data": data,
        "commit": ", ".join(sorted(commits)),
        "reference": "the paper: Table 1, its budget sweep and its longer exposure, on other data",
        "columns": ["measure", "budget", *(name.replace("_", " ") for name in STRATEGIES)],
        "rows": rows,
        "plot": picture,
    }


def _told(value: float | None, measure: str, strategy: str, budget: str) -> str:
    key = (measure, strategy) if strategy == "full" else (measure, strategy, budget)
    paper = PAPER.get(key)
    ours = "" if value is None else f"{value:.3f}"
    return ours if paper is None else f"{ours} | {paper:.3f}"


def _data(report: Mapping[str, Any]) -> str:
    if "columns" in report:
        return f"{report.get('data')} (table {report.get('id')})"
    clips = report.get("clips") or report.get("trials")
    count = len(clips) if isinstance(clips, list) else clips
    return f"{count} clips or trials of {report.get('graph')}, seed {report.get('seed')}"


def markdown_of(found: Mapping[str, Any]) -> str:
    """Return the table as Markdown; a bar inside a cell is escaped."""
    lines = [found["columns"], ["---"] * len(found["columns"]), *found["rows"]]
    rows = ([str(cell).replace("|", "\\|") for cell in line] for line in lines)
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def plot(cells: Sequence[Cell], path: Path) -> None:
    """Draw what each strategy keeps of full resolution over the budget, a panel a measure."""
    need("matplotlib", "plot")
    from matplotlib.figure import Figure

    measures = list(dict.fromkeys(cell.measure for cell in cells))
    figure = Figure(figsize=(4.2 * len(measures), 4.2), layout="constrained")
    panels = figure.subplots(1, len(measures), squeeze=False)[0]
    for panel, measure in zip(panels, measures, strict=True):
        own = [cell for cell in cells if cell.measure == measure]
        for k, strategy in enumerate(STRATEGIES):
            points = sorted(
                (float(Fraction(c.budget)), c.value) for c in own if c.strategy == strategy
            )
            if strategy == "full" and points:
                panel.axhline(points[0][1], color="black", linestyle=":", linewidth=1, label="full")
            elif points:
                marker, line = looks(k)
                xs, ys = zip(*points, strict=True)
                panel.plot(
                    xs, ys, marker=marker, linestyle=line, label=strategy, linewidth=1.4,
                    color=f"C{k}",  # the same in each panel, whichever it has
                )  # fmt: skip
        budgets = sorted({Fraction(cell.budget) for cell in own if cell.strategy != "full"})
        panel.set_xscale("log", base=2)
        panel.set_xticks([float(b) for b in budgets], [str(b) for b in budgets])
        panel.set_title(measure, fontsize=9)
        panel.set_xlabel("share of the pixels")
        panel.set_ylim(bottom=0)
        panel.grid(alpha=0.3)
    names = {line.get_label(): line for panel in panels for line in panel.get_lines()}
    figure.legend(
        list(names.values()), list(names), loc="outside lower center", ncols=5, fontsize=8
    )
    write_figure(figure, path)
