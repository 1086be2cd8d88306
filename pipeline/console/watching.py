"""Looking at a running graph from outside: `ps`, `top`, `logs`, `echo`, `hz`.

Figures are read from the ledger's shared memory; messages are tapped from the bus. Neither slows
the graph: a tap has no account there and copies what it would pin.
"""

import os
import queue
import time
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np
import psutil
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from pipeline.bus.inport import InPort
from pipeline.bus.ledger import Ledger, private_ledger
from pipeline.bus.outport import Arrival
from pipeline.bus.pool import PoolReader
from pipeline.bus.session import Session
from pipeline.contract import outputs_of
from pipeline.errors import RunError
from pipeline.graph.plan import load_operator
from pipeline.messages import Message
from pipeline.node.wiring import key_of
from pipeline.run.rundir import folder_of, memory_of, running
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


def echo(graph: str, output: str, count: int) -> Iterator[str]:
    """One line per message of an output."""
    for i, message in enumerate(_tap(graph, output)):
        yield describe(message)
        if count and i + 1 >= count:
            return


def rate(graph: str, output: str, duration_s: float) -> str:
    """Rate, jitter and age over some seconds."""
    stamps, ages = [], []
    end = time.monotonic() + duration_s
    for message in _tap(graph, output):
        now = time.monotonic_ns()
        stamps.append(now)
        ages.append((now - message.header.stamp_ns) / 1e6)
        if now / 1e9 > end:
            break
    if len(stamps) < 2:
        return f"{output}: fewer than two messages in {duration_s:.1f} s"
    gaps = np.diff(stamps) / 1e6
    return (
        f"{output}: {1000 / gaps.mean():.2f} Hz, gap {gaps.min():.1f} .. {gaps.max():.1f} ms "
        f"(std {gaps.std():.2f}), age {np.median(ages):.1f} ms p50, {len(stamps)} messages"
    )


def describe(message: Message) -> str:
    """A message on one line: small values as they are, arrays by shape."""
    parts = [f"seq {message.header.seq}"]
    for item in fields(message):
        value = getattr(message, item.name)
        if item.name == "header":
            continue
        if isinstance(value, np.ndarray):
            small = np.array2string(value, precision=1, separator=",").replace("\n", "")
            text = small if value.size <= 8 else f"{value.dtype}{list(value.shape)}"
        else:
            text = str(value)
        parts.append(f"{item.name} {text}")
    return "  ".join(parts)


def _tap(graph: str, output: str) -> Iterator[Message]:
    name, facts = find(graph)
    node, _, port = output.partition(".")
    operators = {n["name"]: n["operator"] for n in facts["nodes"]}
    if node not in operators:
        raise RunError(f"{name}: no node {node}{suggest(node, operators)}")
    outputs = outputs_of(load_operator(operators[node]))
    port = port or "out"
    if port not in outputs:
        options = [o if o != "out" else node for o in (f"{node}.{p}" for p in outputs)]
        raise RunError(f"{name}: {node} has no output {port}{suggest(output, options)}")
    arrivals: queue.Queue[Arrival] = queue.Queue(8)  # a slow terminal loses, the graph does not

    def keep(arrival: Arrival) -> None:
        if arrival.message is not None and not arrivals.full():
            arrivals.put_nowait(arrival)

    pool = PoolReader(memory_of(facts), f"{node}.{port}")
    tap = InPort(outputs[port], private_ledger(1, 0).edges[0], pool, 1, keep, tap=True)
    session = Session(folder_of(name), f"tap-{os.getpid()}")
    try:
        stop = session.listen(key_of(facts["graph"], node, port), tap.receive)
        while True:
            message = arrivals.get(timeout=QUIET_S).message
            assert message is not None
            yield message
    except queue.Empty:
        raise RunError(f"{output}: no message for {QUIET_S:.0f} s") from None
    finally:
        stop()
        session.close()
        (folder_of(name) / f"tap-{os.getpid()}.sock").unlink(missing_ok=True)


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
