"""Rows of many objects: one a clip -> means over clips, paired differences, tables."""

from collections.abc import Mapping, Sequence
from math import isnan
from typing import Any

from rich.table import Table

from bench.tracking.budgets import CONTEXT
from bench.tracking.intervals import Block, difference, mean
from pipeline.terminal import lean_table

FIGURES = ("HOTA", "DetA", "AssA", "IDF1")
BESIDE = (CONTEXT, "greedy")  # what every other strategy is compared with
COLUMNS = ("clip", "target", "strategy", "budget", *FIGURES, "objects", "tracks", "frames")
MEANS = ("clips", "target", "strategy", "budget", *FIGURES)
Row = dict[str, Any]
Key = tuple[str, str, str]  # target, budget, strategy


def means_of_many(rows: Sequence[Row]) -> list[Row]:
    """Return a row for each target, budget and strategy: means over clips, 95 % intervals.

    A clip that never shows the target has no figure of it, and is left out.
    """
    found = []
    for (target, budget, strategy), own in _by_strategy(rows).items():
        told: Row = {"target": target, "strategy": strategy, "budget": budget, "clips": len(own)}
        for name in FIGURES:
            middle = mean(_blocks(own, name))
            told[name] = round(middle.iou, 4)
            if not isnan(middle.low):
                told[f"{name}_ci95"] = [round(middle.low, 4), round(middle.high, 4)]
        found.append(told)
    return found


def paired_of_many(rows: Sequence[Row]) -> list[Row]:
    """Return how far each strategy is above others on the same clips, with 95 % intervals."""
    kept = _by_strategy(rows)
    found = []
    for (target, budget, strategy), own in kept.items():
        for beside in BESIDE:
            others = kept.get((target, budget, beside))
            if others is None or beside == strategy:
                continue
            told: Row = {
                "target": target, "strategy": strategy, "beside": beside, "budget": budget,
            }  # fmt: skip
            for name in FIGURES:
                found_difference = difference(_blocks(own, name), _blocks(others, name))
                told[name] = [None if isnan(v) else round(v, 4) for v in found_difference]
            found.append(told)
    return found


def _by_strategy(rows: Sequence[Row]) -> Mapping[Key, list[Row]]:
    found: dict[Key, list[Row]] = {}
    for row in rows:
        if not row["boxes"]:  # TrackEval calls it 0 whatever the tracks are
            continue
        found.setdefault((row["target"], row["budget"], row["strategy"]), []).append(row)
    return found


def _blocks(rows: Sequence[Row], name: str) -> Mapping[str, Block]:
    """Return the figure of each clip; every clip counts once."""
    return {row["clip"]: Block(total=row[name], frames=1, starts=1) for row in rows}


def table_of_many(rows: Sequence[Row]) -> Table:
    """Return a table for a terminal: of clips, or of means."""
    columns = _columns(rows)
    shown = lean_table()
    for column in columns:
        shown.add_column(column, justify="left" if column in columns[:4] else "right")
    for row in rows:
        shown.add_row(*(_cell(row, column) for column in columns))
    return shown


def markdown_of_many(rows: Sequence[Row]) -> str:
    """Return the same as Markdown."""
    columns = _columns(rows)
    lines = [columns, ["---"] * len(columns), *([_cell(r, c) for c in columns] for r in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _columns(rows: Sequence[Row]) -> tuple[str, ...]:
    return COLUMNS if not rows or "clip" in rows[0] else MEANS


def _cell(row: Row, column: str) -> str:
    if column not in FIGURES:
        return str(row[column])
    ends = row.get(f"{column}_ci95")
    return f"{row[column]:.3f}" + (f" ({ends[0]:.3f} to {ends[1]:.3f})" if ends else "")
