"""What a terminal of 80 columns shows: tables without lines between columns, bounded log lines."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich import box
from rich.highlighter import NullHighlighter
from rich.logging import RichHandler
from rich.table import Table
from rich.text import Text

from pipeline.text import harmless

MOST_LOGGED = 8000  # characters of one record, with its traceback


class _Bounded(logging.Formatter):
    """Whatever is logged, by libraries too, in so many printable characters."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record's text."""
        return harmless(super().format(record), MOST_LOGGED, lines=True)


def log_handler() -> logging.Handler:
    """Return a handler that shows records without colours: Rich takes minutes over a long one."""
    handler = RichHandler(show_path=False, highlighter=NullHighlighter(), keywords=[])
    handler.setFormatter(_Bounded("%(message)s"))
    return handler


def lean_table(
    title: str = "",
    *,
    names: Sequence[str] = (),
    words: Sequence[str] = (),
    figures: Sequence[str] = (),
) -> Table:
    """An empty table: columns of names, which stay whole, of words, which wrap, of figures."""
    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, padding=0
    )  # fmt: skip
    for name in names:
        table.add_column(name, no_wrap=True, overflow="fold")
    for name in words:
        table.add_column(name, overflow="fold")
    for name in figures:
        table.add_column(name, justify="right", overflow="fold")
    return table


def brief(value: float) -> str:
    """Three figures, as far as they are before the point or one or two behind it.

    >>> brief(0.317), brief(4.8), brief(37.24), brief(1204.6)
    ('0.32', '4.80', '37.2', '1205')
    """
    return f"{value:.{2 if value < 9.995 else 1 if value < 99.95 else 0}f}"


def pair(spread: Mapping[str, float]) -> str:
    """Median and 99th percentile of a summary."""
    return f"{brief(spread['p50'])}/{brief(spread['p99'])}"


def rest(account: Mapping[str, Any]) -> str:
    """How many messages of an edge were not delivered; `losses` tells what became of them."""
    return str(account["offered"] - account["delivered"])


def losses(origin: str, end: str, account: Mapping[str, Any], *, broken: bool) -> Iterator[Text]:
    """A line on an edge that dropped or lost messages; none on what is merely in flight."""
    parts = [f"{n} dropped, {reason}" for reason, n in account["dropped"].items()]
    if lost := account["lost_in_crash"]:
        parts.append(f"{lost} lost in a crash")
    line = Text("; ".join(parts))
    if broken:
        line.append("; " if parts else "").append("lost messages it was promised", "red")
    if line:
        yield Text.assemble(f"{origin} -> {end}: ", line)
