"""`ps`, `top`, `logs` of graphs on several hosts: questions to agents -> tables and lines."""

import time
from collections.abc import Iterator, Mapping

import msgspec
from rich.console import Console
from rich.live import Live
from rich.table import Table

from pipeline.errors import FoveaError, RunError, Silent
from pipeline.fleet.deploy import Fleet, Hosts, remembered
from pipeline.fleet.status_tables import (
    add_rows,
    nodes_of,
    process_rows,
    process_table,
    silence,
    top_tables,
)
from pipeline.protocol import fleet as wire


def fleet_table(graphs: Mapping[str, Hosts]) -> Table:
    """Every process on every host, every host that is silent, every node that is lost with it."""
    table = process_table()
    for graph, hosts in graphs.items():
        with Fleet(hosts) as fleet:
            for label, said in fleet.states(graph).items():
                add_rows(table, graph, process_rows(label, said, nodes_of(hosts.nodes, label)))
    return table


def fleet_json(graphs: Mapping[str, Hosts]) -> bytes:
    """The same and more as JSON: graph -> host -> states, or why there are none."""
    found = {}
    for graph, hosts in graphs.items():
        with Fleet(hosts) as fleet:
            found[graph] = {
                label: silence(said, nodes_of(hosts.nodes, label))
                if isinstance(said, str)
                else said
                for label, said in fleet.states(graph).items()
            }
    return msgspec.json.encode(found)


def known_graph(graph: str) -> tuple[str, Hosts] | None:
    """A graph that was brought up from here, the only one for ""; None when there is none."""
    known = remembered()
    if not graph and len(known) == 1:
        return next(iter(known.items()))
    return (graph, known[graph]) if graph in known else None


def fleet_top(graph: str, hosts: Hosts, every_s: float, *, once: bool, console: Console) -> None:
    """Edges, nodes and clocks of all hosts, refreshed until Ctrl-C."""
    with Fleet(hosts) as fleet:
        before, at_s = fleet.states(graph), time.monotonic()
        time.sleep(min(every_s, 1.0))
        if once:
            now, seconds = fleet.states(graph), time.monotonic() - at_s
            console.print(top_tables(before, now, seconds, hosts.nodes))
            return
        with Live(console=console, auto_refresh=False, screen=True) as live:
            while True:
                now, now_s = fleet.states(graph), time.monotonic()
                live.update(top_tables(before, now, now_s - at_s, hosts.nodes), refresh=True)
                before, at_s = now, now_s
                time.sleep(every_s)


def fleet_log(graph: str, node: str, count: int) -> Iterator[str]:
    """The last lines of a node's log, wherever it runs; raises `RunError` when nowhere."""
    known = remembered()
    wanted = {graph: known[graph]} if graph in known else ({} if graph else known)
    silent = []
    for name, hosts in wanted.items():
        with Fleet(hosts) as fleet:
            for label in hosts.points:
                try:
                    found = fleet.ask(label, "log", wire.Lines(name, node, count), wire.Log)
                except Silent as error:
                    silent.append(str(error))
                except FoveaError:
                    continue  # it is not there
                else:
                    yield from found.lines
                    return
    raise RunError(f"no log of a node {node}" + "".join(f"; {why}" for why in silent))
