"""IoU over the pixel budget, a panel a target and protocol: rows in, a picture out.

Strategies often coincide. So that no curve covers another, each has a marker, a line style and a
width of its own, wide ones are below narrow ones, and each is drawn a little beside the budget.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench.outputs import write_figure
from bench.tracking.cases import LONG
from bench.tracking.report import Row, share

if TYPE_CHECKING:  # an extra installs it
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = "os^Dv<>pXPh*"
LINES = ("-", "--", "-.", ":")
APART = 0.22  # of an octave, over which the strategies of a budget are spread
WIDEST, NARROWEST = 3.5, 1.0  # points


def plot(rows: Sequence[Row], path: Path) -> None:
    """Write the picture in the format of the suffix; write nothing if no row has a figure."""
    rows = [row for row in rows if row["iou"] is not None]
    if rows:
        write_figure(figure_of(rows), path)


def figure_of(rows: Sequence[Row]) -> "Figure":
    """Return a figure: a panel for each target, a curve for each strategy, the legend below."""
    from matplotlib.figure import Figure

    rows = [_by_protocol(row) for row in rows]
    targets = list(dict.fromkeys(row["target"] for row in rows))
    names = sorted({row["strategy"] for row in rows})
    figure = Figure(figsize=(max(5.0, 4.2 * len(targets)), 4.4), layout="constrained")
    panels = figure.subplots(1, len(targets), squeeze=False)[0]
    for panel, target in zip(panels, targets, strict=True):
        for k, name in enumerate(names):
            own = [r for r in rows if (r["target"], r["strategy"]) == (target, name)]
            if own:
                _curve(panel, own, k, len(names))
        _axes(panel, [row for row in rows if row["target"] == target], target)
    curves = {c.get_label(): c for panel in panels for c in panel.containers}
    figure.legend(
        [curves[name] for name in names], names,
        loc="outside lower center", ncols=min(4, len(names)), fontsize=8,
    )  # fmt: skip
    return figure


def _by_protocol(row: Row) -> Row:
    """Return a row whose protocol is named by its target, so that it has a panel of its own."""
    if row.get("protocol") != "long":
        return row
    strategy = row["strategy"].removesuffix(LONG)
    return row | {"target": row["target"] + LONG, "strategy": strategy}


def looks(k: int) -> tuple[str, str]:
    """Return marker and line style of the `k`-th curve; the first 48 are distinct.

    >>> looks(0), looks(1), len({looks(k) for k in range(48)})
    (('o', '-'), ('s', '--'), 48)
    """
    return MARKERS[k % len(MARKERS)], LINES[(k + k // len(MARKERS)) % len(LINES)]


def _curve(panel: "Axes", rows: Sequence[Row], k: int, count: int) -> None:
    """Draw the `k`-th of `count` curves, beside the budgets according to its index."""
    points = sorted(rows, key=lambda row: share(row["budget"]))
    beside = 2 ** (APART * (k - (count - 1) / 2) / max(1, count - 1))
    spread = [_arms(row) for row in points]
    marker, line = looks(k)
    width = WIDEST - (WIDEST - NARROWEST) * k / max(1, count - 1)
    panel.errorbar(
        [share(row["budget"]) * beside for row in points],
        [row["iou"] for row in points],
        yerr=[list(side) for side in zip(*spread, strict=True)] if any(map(any, spread)) else None,
        marker=marker, linestyle=line, color=f"C{k % 10}", linewidth=width,
        markersize=6, markeredgewidth=1.2, elinewidth=1,
        markerfacecolor="none", capsize=2, label=rows[0]["strategy"],
    )  # fmt: skip


def _arms(row: Row) -> tuple[float, float]:
    """Return how far the interval reaches below and above; 0 for one clip."""
    if not row["ci95"] or None in row["ci95"]:
        return 0.0, 0.0
    low, high = row["ci95"]
    return max(0.0, row["iou"] - low), max(0.0, high - row["iou"])


def _axes(panel: "Axes", rows: Sequence[Row], target: str) -> None:
    budgets = sorted({row["budget"] for row in rows}, key=share)
    panel.set_xscale("log", base=2)
    panel.set_xticks([share(budget) for budget in budgets], budgets)
    panel.set_xticks([], minor=True)
    panel.set(title=target, xlabel="share of the pixels", ylabel="IoU")
    panel.set_ylim(bottom=min(0.0, panel.get_ylim()[0]))
    panel.grid(axis="y", alpha=0.3)
