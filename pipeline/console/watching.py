"""Looking at running graphs from outside: `ps`, `top`; figures come from the ledger's memory.

What outputs send is heard by `pipeline.console.listening`.
"""

import time
from collections.abc import Iterator
from typing import Any

import psutil
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from pipeline.bus.ledger import Ledger
from pipeline.errors import RunError
from pipeline.run.rundir import memory_of, running
from pipeline.settings import suggest
from pipeline.terminal import brief, lean_table, losses, pair, rest

QUIET_S = 10.0  # without a message for this long, echo says so and leaves


def process_table() -> Table:
    """Every process of every running graph of this user."""
    table = lean_table(
        names=("graph", "process"), words=("nodes",), figures=("pid", "CPU s", "RSS MB")
    )
    for graph, facts in running().items():
        for process, pid in facts["pids"].items():
            nodes = ", ".join(n["name"] for n in facts["nodes"] if n["process"] == process)
            try:
                seen = psutil.Process(pid)
                used = [f"{sum(seen.cpu_times()[:2]):.1f}", f"{seen.memory_info().rss / 1e6:.0f}"]
            except psutil.Error:
                used = ["gone", ""]
            table.add_row(Text(graph), Text(process), Text(nodes), str(pid), *used)
    return table


def top(graph: str, every_s: float, *, once: bool, console: Console) -> None:
    """A table per edge and per node, refreshed until Ctrl-C or the end of the graph."""
    name, facts = find(graph)
    ledger = _ledger(facts)
    tables = _refreshed(facts, ledger, every_s)
    next(tables)
    time.sleep(min(every_s, 1.0))
    if once:
        console.print(next(tables))
        return
    with Live(console=console, auto_refresh=False, screen=True) as live:
        while name in running():
            live.update(next(tables), refresh=True)
            time.sleep(every_s)


def _refreshed(facts: dict[str, Any], ledger: Ledger, every_s: float) -> Iterator[Group]:
    """The tables again and again, with rates since the time before."""
    sent, at_s = [0] * len(ledger.edges), time.monotonic() - every_s
    while True:
        now, now_s = [edge.sent for edge in ledger.edges], time.monotonic()
        rates = [(b - a) / (now_s - at_s) for a, b in zip(sent, now, strict=True)]
        sent, at_s = now, now_s
        yield _top_tables(facts, ledger, rates)


def _top_tables(facts: dict[str, Any], ledger: Ledger, rates: list[float]) -> Group:
    accounts = ("Hz", "offered", "delivered", "rest", "age ms")
    edges = lean_table("edges, p50", names=("from", "to"), figures=accounts)
    told: list[Text] = []
    for names in facts["edges"]:
        account, hertz = ledger.edges[names["index"]], rates[names["index"]]
        shown = account.report()
        edges.add_row(
            Text(names["from"]), Text(names["to"]), f"{hertz:.1f}", str(shown["offered"]),
            str(shown["delivered"]), rest(shown), brief(account.age.summary()["p50"]),
        )  # fmt: skip
        told += losses(names["from"], names["to"], shown, broken=bool(account.broken))
    work = ("epoch", "handled", "last seq", "handler ms")
    nodes = lean_table("nodes, p50/p99", names=("node", "state"), figures=work)
    for facts_of in facts["nodes"]:
        node = ledger.nodes[facts_of["index"]]
        nodes.add_row(
            Text(facts_of["name"]), node.condition, str(node.epoch), str(node.handled),
            str(node.last_seq), pair(node.histograms["handler"].summary()),
        )  # fmt: skip
    return Group(edges, *told, nodes)


def find(graph: str) -> tuple[str, dict[str, Any]]:
    """A running graph's name and facts, the only one's for ""; raises `RunError`."""
    found = running()
    if graph and graph in found:
        return graph, found[graph]
    if not graph and len(found) == 1:
        return next(iter(found.items()))
    if graph:
        raise RunError(f"no graph {graph} runs{suggest(graph, found)}")
    raise RunError(f"expected one running graph, got {', '.join(found) or 'none'}")


def _ledger(facts: dict[str, Any]) -> Ledger:
    return Ledger.open(memory_of(facts))
