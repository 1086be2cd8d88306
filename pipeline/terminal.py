"""Terminal output: tables that fit into narrow terminals, and log lines of bounded length."""

import contextlib
import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.highlighter import NullHighlighter
from rich.logging import RichHandler
from rich.measure import Measurement
from rich.segment import SegmentLines
from rich.table import Column, Table
from rich.text import Text

from pipeline.text import harmless

MOST_LOGGED = 8000  # characters of one record, with its traceback
MOST_WIDTH = 10_000  # upper limit for the measured width of a cell, in characters
WORDS_WIDTH = 14  # characters that wrapped text needs


class _Bounded(logging.Formatter):
    """Limits each log record, also of libraries, to a number of printable characters."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record's text."""
        return harmless(super().format(record), MOST_LOGGED, lines=True)


def console(*, stderr: bool = False, soft_wrap: bool = False, highlight: bool = True) -> Console:
    """Return a console that writes only plain text where `NO_COLOR` is set.

    Rich alone would omit colours, but still write bold text and move the cursor.
    """
    found = Console(stderr=stderr, soft_wrap=soft_wrap, highlight=highlight)
    if found.no_color:
        return Console(
            stderr=stderr, soft_wrap=soft_wrap, highlight=highlight, force_terminal=False
        )
    return found


class _Handler(RichHandler):
    """Wraps records for a terminal; in a file, pipe or journal each record is its own line."""

    def emit(self, record: logging.LogRecord) -> None:
        """Show a record."""
        if self.console.is_terminal:
            super().emit(record)
            return
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(record.created))
        with contextlib.suppress(OSError, ValueError):
            self.console.file.write(f"{when} {record.levelname:8} {self.format(record)}\n")
            self.console.file.flush()


def log_handler(*, stderr: bool = False) -> logging.Handler:
    """Return a handler without highlighting, for which Rich takes minutes on a long record."""
    handler = _Handler(
        console=console(stderr=stderr), show_path=False, highlighter=NullHighlighter(), keywords=[]
    )  # fmt: skip
    handler.setFormatter(_Bounded("%(message)s"))
    return handler


def cropped(shown: RenderableType, console: Console) -> RenderableType:
    """Return the top lines that fit into the terminal, and the number of the others."""
    lines = console.render_lines(shown, pad=False)
    if len(lines) <= console.height:
        return shown
    fit = max(0, console.height - 1)
    more = f"{len(lines) - fit} lines more: a taller terminal or `fovea top --once` shows them"
    return Group(SegmentLines(lines[:fit], new_lines=True), Text(more, no_wrap=True))


class LeanTable(Table):
    """A table that omits columns when the terminal is too narrow, and lists them."""

    def __init__(self, title: str, spare: Sequence[str]) -> None:
        """`spare`: headings of columns in the order in which they are omitted."""
        super().__init__(
            title=title, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, padding=0
        )
        self._spare = spare

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table, with fewer columns if necessary."""
        kept, left_out = self._fitting(console, options)
        if not left_out:
            yield from super().__rich_console__(console, options)
            return
        words = f"too narrow for: {', '.join(left_out)}"
        narrow = Table(
            title=self.title, title_justify="left", box=self.box, show_edge=False, padding=0,
            caption=words, caption_justify="left",
        )  # fmt: skip
        columns = [column for column in self.columns if str(column.header) in kept]
        narrow.columns = [replace(column, _index=i) for i, column in enumerate(columns)]
        narrow.rows = self.rows
        yield narrow

    def _fitting(self, console: Console, options: ConsoleOptions) -> tuple[list[str], list[str]]:
        """Return the headings that stay and those that are omitted."""
        widths = {str(c.header): self._width(console, options, c) for c in self.columns}
        left_out: list[str] = []
        for name in self._spare:
            if sum(widths.values()) + len(widths) - 1 <= options.max_width or len(widths) == 1:
                break
            del widths[name]
            left_out.append(name)
        return list(widths), [name for name in left_out if name]

    def _width(self, console: Console, options: ConsoleOptions, column: Column) -> int:
        """Return the width a column needs: text may wrap, names and figures must not."""
        cells = (column.header, *column.cells)
        wide = options.update(max_width=MOST_WIDTH)
        widest = max(Measurement.get(console, wide, cell).maximum for cell in cells)
        return widest if column.no_wrap else min(widest, WORDS_WIDTH)


def lean_table(
    title: str = "",
    *,
    names: Sequence[str] = (),
    words: Sequence[str] = (),
    figures: Sequence[str] = (),
    spare: Sequence[str] = (),
) -> Table:
    """Return an empty table with columns of names (never wrapped), text (wrapped) and figures.

    When it does not fit, columns are omitted: first `spare`, then figures from the right, then
    text; the first column of names stays.
    """
    order = [*spare, *reversed(figures), *reversed(words), *reversed(names[1:])]
    table = LeanTable(title, list(dict.fromkeys(order)))
    for name in names:
        table.add_column(name, no_wrap=True, overflow="fold")
    for name in words:
        table.add_column(name, overflow="fold")
    for name in figures:
        table.add_column(name, justify="right", no_wrap=True, overflow="fold")
    return table


def brief(value: float) -> str:
    """Return three significant digits with at most two decimals.

    >>> brief(0.317), brief(4.8), brief(37.24), brief(1204.6)
    ('0.32', '4.80', '37.2', '1205')
    """
    return f"{value:.{2 if value < 9.995 else 1 if value < 99.95 else 0}f}"


def pair(spread: Mapping[str, float]) -> str:
    """Return median and 99th percentile of a summary as text."""
    return f"{brief(spread['p50'])}/{brief(spread['p99'])}"


def rest(account: Mapping[str, Any]) -> str:
    """Return the number of undelivered messages of an edge; `losses` breaks it down."""
    return str(account["offered"] - account["delivered"])


def losses(origin: str, end: str, account: Mapping[str, Any], *, broken: bool) -> Iterator[Text]:
    """Yield a line for an edge that dropped, lost or ignored messages; none for those in flight."""
    parts = [f"{n} dropped, {reason}" for reason, n in account["dropped"].items()]
    if lost := account["lost_in_crash"]:
        parts.append(f"{lost} lost with a process")
    if strange := account.get("unexpected"):  # hosts of an earlier commit do not tell
        parts.append(f"{strange} ignored, damaged or sent twice")
    line = Text("; ".join(parts))
    if broken:
        line.append("; " if parts else "").append("lost messages it was promised", "red")
    if line:
        yield Text.assemble(f"{origin} -> {end}: ", line)
