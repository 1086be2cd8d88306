"""Pictures of result files, beside them: `python -m bench.results --plots`.

Tables by budget get curves, reports of left-out rules what each one gained or lost without it.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.outputs import write_figure
from bench.reading.plot import plot as plot_reading
from bench.results.report import Report
from bench.results.table import ResultTable
from bench.tracking.plots import figure_of
from bench.tracking.report import Row
from pipeline.extras import need

FIGURE = re.compile(r"\**([.\d]+)\**(?: \(([.\d]+)[–-]([.\d]+)\))?")  # and its interval
GAIN = re.compile(r"([+-][.\d]+)(?: \(([+-][.\d]+) \.\. ([+-][.\d]+)\))?")
ALL_RULES = "all rules"  # the row of a report that the others are compared with
NO_STRATEGY = {"target", "budget", "in ROI", "n", "starts", "clips"}
SIGNS = {"share in the ROI": ("C0", "o", 0.15), "IoU": ("C1", "s", -0.15)}  # and how far above


def draw_table(found: ResultTable, path: Path) -> bool:
    """Draw a table of strategies by target and budget; False where it is no such table."""
    rows = curves_of(found)
    if rows:
        need("matplotlib", "plot")
        write_figure(figure_of(rows), path)
    return bool(rows)


def curves_of(found: ResultTable) -> list[Row]:
    """Return a table's figures, one for each strategy, target and budget; none of other tables.

    Of several figures in a cell the first one counts.
    """
    if not {"target", "budget"} <= set(found.columns):
        return []
    rows: list[Row] = []
    for values in found.rows:
        cells = dict(zip(found.columns, map(str, values), strict=True))
        for column, text in cells.items():
            told = FIGURE.match(text)
            if column in NO_STRATEGY or not told or "−" in column:
                continue
            low, high = told[2], told[3]
            rows.append({
                "target": cells["target"], "budget": cells["budget"],
                "strategy": column.replace("*", "").partition(" (")[0], "iou": float(told[1]),
                "ci95": [float(low), float(high)] if low else None,
            })  # fmt: skip
    return rows


def draw_report(report: Report, path: Path) -> bool:
    """Draw a bench's own report; False for one of which nothing is drawn."""
    draw = DRAWN.get(report.bench)
    rows = [row for row in report.values.get("rows", ()) if row.get("without") != ALL_RULES]
    if not draw or not rows:
        return False
    need("matplotlib", "plot")
    draw(rows, path)
    return True


def draw_rules(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw what the loop gained without each rule: a panel a policy and target, a line a rule."""
    from matplotlib.figure import Figure

    groups = list(dict.fromkeys((row["policy"], row["target"]) for row in rows))
    most = max(sum((r["policy"], r["target"]) == group for r in rows) for group in groups)
    size = 3.0 + 2.8 * len(groups), 1.6 + 0.3 * most
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(1, len(groups), squeeze=False)[0]
    shown: tuple[str, ...] = ()
    for panel, group in zip(panels, groups, strict=True):
        of = [row for row in rows if (row["policy"], row["target"]) == group]
        for name, (colour, marker, above) in SIGNS.items():
            for place, row in enumerate(of):
                told = GAIN.match(row[f"{name}: gained without"])
                if told is None:
                    continue
                middle, low, high = (float(v) if v else float(told[1]) for v in told.groups())
                panel.errorbar(
                    [middle], [above - place], xerr=[[middle - low], [high - middle]],
                    color=colour, marker=marker, capsize=2, linestyle="none", label=name,
                )  # fmt: skip
        names = tuple(row["without"] for row in of)
        panel.set_yticks([-k for k in range(len(of))], names if names != shown else [])
        shown = names
        panel.axvline(0, color="black", linewidth=0.8)
        panel.set(title=", ".join(group), xlabel="gained without it")
        panel.grid(axis="x", alpha=0.3)
    marks = dict(zip(*reversed(panels[0].get_legend_handles_labels()), strict=True))
    figure.legend(marks.values(), marks, loc="outside lower center", ncols=2, fontsize=8)
    write_figure(figure, path)


def draw_manipulation(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw the share of trials that were completed, over the budget."""
    of: list[Row] = [
        {
            "target": "completed", "budget": row["budget"], "strategy": row["strategy"],
            "iou": row["complete"]["share"], "ci95": row["complete"]["interval"],
        }
        for row in rows
    ]  # fmt: skip
    figure = figure_of(of)
    figure.axes[0].set_ylabel("share of the trials")
    write_figure(figure, path)


DRAWN: Mapping[str, Callable[[Any, Path], None]] = {
    "rules": draw_rules, "rules_from_starts": draw_rules, "reading": plot_reading,
    "manipulation": draw_manipulation,
}  # fmt: skip
