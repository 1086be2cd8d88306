"""Share of texts read over the pixel budget, a curve for each strategy: rows in, a picture out."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from bench.outputs import write_figure
from bench.tracking.plots import looks
from pipeline.extras import need


def plot(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write the picture in the format of the suffix."""
    need("matplotlib", "plot")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 4.4), layout="constrained")
    panel = figure.subplots()
    names = list(dict.fromkeys(row["strategy"] for row in rows if row["budget"] != "1"))
    for k, name in enumerate(names):
        own = sorted(
            (r for r in rows if r["strategy"] == name), key=lambda r: Fraction(r["budget"])
        )
        shares = [float(Fraction(row["budget"])) * 2 ** (0.02 * k) for row in own]
        known = all(r["ci95"] for r in own)
        ends = [r["ci95"] or [r["read"]] * 2 for r in own]
        arms = [[abs(e[k] - r["read"]) for r, e in zip(own, ends, strict=True)] for k in (0, 1)]
        marker, line = looks(k)
        panel.errorbar(
            shares, [row["read"] for row in own], yerr=arms if known else None, marker=marker,
            linestyle=line, label=name, capsize=2, linewidth=1.4, markersize=5,
        )  # fmt: skip
    for row in rows:
        if row["budget"] == "1":
            panel.axhline(row["read"], color="black", linewidth=1, linestyle=":", label="full")
    panel.set_xscale("log", base=2)
    budgets = sorted({Fraction(row["budget"]) for row in rows if row["budget"] != "1"})
    panel.set_xticks([float(b) for b in budgets], [str(b) for b in budgets])
    panel.set_xlabel("share of the pixels")
    panel.set_ylabel("share of legible texts read")
    panel.set_ylim(0, 1)
    panel.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8)
    write_figure(figure, path)
