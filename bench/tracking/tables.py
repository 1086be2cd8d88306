"""The rows of an evaluation that were asked for, as a table for a terminal and as Markdown."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import JustifyMethod
from rich.table import Table
from rich.text import Text

from bench.tracking.conclusions import sentences
from bench.tracking.report import Row, is_asked, share
from pipeline.terminal import lean_table

PAPER = "paper (other data)"
NAMES = ("target", "budget", "strategy")
FIGURES = (
    *("IoU", "95 %", PAPER, "all frames", "success", "precision", "until lost", "in ROI"),
    *("pixels", "starts", "frames"),
)
WHOLE = ("budget", "IoU", "95 %")  # never broken into two lines
IN_FILES = ("pixels", "frames")  # of Markdown and JSON alone
SELDOM = (
    *("95 %", PAPER, "all frames", "success", "precision", "until lost", "in ROI"),
)  # left out where no row has one


def asked_rows(report: Mapping[str, Any]) -> list[Row]:
    """Return rows over all clips of the targets asked for, in the order of targets and budgets."""
    rows = [r for r in report["rows"] if r["clip"] == "all" or len(report["clips"]) == 1]
    rows = [r for r in rows if is_asked(r, report)]
    return sorted(rows, key=lambda r: (r["target"], share(r["budget"]), r["strategy"]))


def table(report: Mapping[str, Any]) -> Table:
    """Return a table of the rows asked for, without empty columns and those only for files."""
    cells = [_cells(row) for row in asked_rows(report)]
    columns = [column for column in _columns(cells) if column not in IN_FILES]
    shown = lean_table()
    for column in columns:
        side: JustifyMethod = "left" if column in (*NAMES, "95 %") else "right"
        shown.add_column(column, justify=side, no_wrap=column in WHOLE, overflow="fold")
    for row in cells:
        shown.add_row(*(Text(row[column]) for column in columns))
    return shown


def markdown(report: Mapping[str, Any]) -> str:
    """Return the same rows, the paired differences and the sentences as Markdown."""
    cells = [_cells(row) for row in asked_rows(report)]
    columns = _columns(cells)
    lines = [_line(columns), _line(["---"] * len(columns))]
    lines += [_line([row[column] for column in columns]) for row in cells]
    pairs = [row for row in report["paired"] if is_asked(row, report)]
    if pairs:
        with_interval = any(row["ci95"] for row in pairs)
        heads = [*NAMES, "against", "IoU", *(["95 %"] if with_interval else [])]
        lines += ["", _line(heads), _line(["---"] * len(heads))]
    for row in pairs:
        names = [row[name] for name in (*NAMES, "against")]
        interval = [_interval(row["ci95"], "+.3f")] if with_interval else []
        lines.append(_line([*names, _shown(row["difference"], "+.3f"), *interval]))
    return "\n".join([*lines, "", *(f"- {each}" for each in sentences(report))]) + "\n"


def _columns(cells: Sequence[Mapping[str, str]]) -> list[str]:
    return [c for c in (*NAMES, *FIGURES) if c not in SELDOM or any(row[c] for row in cells)]


def _cells(row: Row) -> dict[str, str]:
    long = row.get("protocol") == "long"  # a short start is too short to be lost
    return {
        **{name: row[name] for name in NAMES},
        "IoU": _shown(row["iou"]),
        "95 %": _interval(row["ci95"]),
        PAPER: _shown(row.get("paper")),
        "all frames": _shown(row.get("iou_all_frames")),
        **{name: _shown(row.get(name)) if long else "" for name in ("success", "precision")},
        "until lost": _shown(row.get("until_lost"), ".0f") if long else "",
        "in ROI": _shown(row.get("roi_coverage")),
        "pixels": f"{row['pixels']:.4f}",
        "starts": str(row["starts"]),
        "frames": str(row["frames"]),
    }


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _interval(ends: Sequence[float | None] | None, form: str = ".3f") -> str:
    between = " – " if "+" in form else "–"
    return between.join(_shown(end, form) for end in ends) if ends else ""


def _shown(value: float | None, form: str = ".3f") -> str:
    return "" if value is None else format(value, form)
