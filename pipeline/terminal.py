"""Tables for a terminal: without lines between columns, so that names stay whole in 80 of them."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table


def lean_table(title: str = "", left: Sequence[str] = (), right: Sequence[str] = ()) -> Table:
    """An empty table: columns of words, then columns of figures."""
    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, padding=0
    )  # fmt: skip
    for name in left:
        table.add_column(name, overflow="fold")
    for name in right:
        table.add_column(name, justify="right", overflow="fold")
    return table


def pair(spread: Mapping[str, float], digits: int = 2) -> str:
    """Median and 99th percentile of a summary."""
    return f"{spread['p50']:.{digits}f}/{spread['p99']:.{digits}f}"


def not_delivered(account: Mapping[str, Any]) -> str:
    """What became of the messages of an edge's account that nobody has handled."""
    parts = [(f"dropped, {reason}", n) for reason, n in account["dropped"].items()]
    parts += [("in flight", account["in_flight"]), ("lost in a crash", account["lost_in_crash"])]
    return "; ".join(f"{n} {what}" for what, n in parts if n) or "0"
