"""`ps`, `top`, `logs` of graphs on several boxes: questions to agents -> tables and lines."""

import time
from collections.abc import Iterator, Mapping

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table

from pipeline.errors import FoveaError, RunError
from pipeline.fleet import wire
from pipeline.fleet.deploy import Fleet, Hosts, remembered

States = Mapping[str, "list[wire.State] | str"]


def fleet_table(graphs: Mapping[str, Hosts]) -> Table:
    """Every process on every box, every box that is silent."""
    table = Table(title="boxes")
    for name in ("graph", "box", "state", "process", "nodes", "pid", "CPU s", "RSS MB", "restarts"):
        table.add_column(name)
    for graph, hosts in graphs.items():
        with Fleet(hosts) as fleet:
            for label, states in fleet.states(graph).items():
                for row in _rows(label, states):
                    table.add_row(graph, *row)
    return table


def fleet_json(graphs: Mapping[str, Hosts]) -> bytes:
    """The same and more as JSON: graph -> box -> states, or why there are none."""
    found = {}
    for graph, hosts in graphs.items():
        with Fleet(hosts) as fleet:
            found[graph] = fleet.states(graph)
    return wire.encode(found)


def _rows(label: str, states: list[wire.State] | str) -> Iterator[tuple[str, ...]]:
    if isinstance(states, str):
        yield (label, "[red]lost[/]", "", "", "", "", "", "")
        return
    for state in states:
        said = f"[red]{state.phase}[/] {state.failure}" if state.failure else state.phase
        away = [box.label for box in state.boxes if box.lost]
        said += f", does not see {', '.join(away)}" if away else ""
        yield (label, said, "", "", "", "", "", "")
        for process in state.processes:
            yield (
                "", "", process.name, ", ".join(process.nodes), str(process.pid),
                f"{process.cpu_s:.1f}", f"{process.rss_mb:.0f}", str(process.restarts),
            )  # fmt: skip


def known_graph(graph: str) -> tuple[str, Hosts] | None:
    """A graph that was brought up from here, the only one for ""; None when there is none."""
    known = remembered()
    if not graph and len(known) == 1:
        return next(iter(known.items()))
    return (graph, known[graph]) if graph in known else None


def fleet_top(graph: str, hosts: Hosts, every_s: float, *, once: bool, console: Console) -> None:
    """Edges, nodes and clocks of all boxes, refreshed until Ctrl-C."""
    with Fleet(hosts) as fleet:
        before, at_s = fleet.states(graph), time.monotonic()
        time.sleep(min(every_s, 1.0))
        if once:
            console.print(_tables(before, fleet.states(graph), time.monotonic() - at_s))
            return
        with Live(console=console, auto_refresh=False, screen=True) as live:
            while True:
                now, now_s = fleet.states(graph), time.monotonic()
                live.update(_tables(before, now, now_s - at_s), refresh=True)
                before, at_s = now, now_s
                time.sleep(every_s)


def fleet_log(graph: str, node: str, count: int) -> Iterator[str]:
    """The last lines of a node's log, wherever it runs; raises `RunError` when nowhere."""
    known = remembered()
    wanted = {graph: known[graph]} if graph in known else ({} if graph else known)
    said = []
    for name, hosts in wanted.items():
        with Fleet(hosts) as fleet:
            for label in hosts.points:
                try:
                    found = fleet.ask(label, "log", wire.Lines(name, node, count), wire.Log)
                except FoveaError as error:
                    said.append(str(error))
                    continue
                yield from found.lines
                return
    silent = [why for why in said if "no agent answers" in why]
    raise RunError(f"no log of a node {node}" + "".join(f"; {why}" for why in silent))


def _tables(before: States, now: States, seconds: float) -> Group:
    edges, nodes, boxes = Table(title="edges"), Table(title="nodes"), Table(title="boxes")
    for column in ("edge", "box", "Hz", "delivered", "dropped", "in flight", "lost", "age p50"):
        edges.add_column(column)
    for column in ("node", "box", "state", "handled", "handler p50 / p99 ms", "hop p50 / p99 ms"):
        nodes.add_column(column)
    for column in ("box", "sees", "", "round trip", "its clock is ahead"):
        boxes.add_column(column)
    earlier = {
        (label, edge.end): edge.sent
        for label, states in before.items()
        for state in states
        if isinstance(state, wire.State)
        for edge in state.edges
    }
    for label, states in now.items():
        if isinstance(states, str):
            boxes.add_row(label, "", "[red]lost[/]", "", "")
            continue
        for state in states:
            for edge in state.edges:
                edges.add_row(*_edge_row(label, edge, earlier, seconds))
            for node in state.nodes:
                nodes.add_row(*_node_row(label, node))
            for other in state.boxes:
                boxes.add_row(*_box_row(label, other))
    return Group(edges, nodes, boxes)


def _edge_row(
    label: str, edge: wire.EdgeState, earlier: Mapping[tuple[str, str], int], seconds: float
) -> tuple[str, ...]:
    rate = (edge.sent - earlier.get((label, edge.end), edge.sent)) / seconds
    account = edge.account
    dropped = ", ".join(f"{n} {why}" for why, n in account["dropped"].items())
    broken = " [red]broken[/]" if edge.broken else ""
    error = f" ± {edge.age_error_ms:.1f}" if edge.age_error_ms else ""
    return (
        f"{edge.origin} -> {edge.end}{broken}", label, f"{rate:.1f}", str(account["delivered"]),
        dropped, str(account["in_flight"]), str(account["lost_in_crash"]),
        f"{edge.age_ms['p50']:.1f}{error} ms",
    )  # fmt: skip


def _node_row(label: str, node: wire.NodeState) -> tuple[str, ...]:
    return (
        node.name, label, node.condition, str(node.handled),
        f"{node.handler_ms['p50']:.2f} / {node.handler_ms['p99']:.2f}",
        f"{node.hop_ms['p50']:.2f} / {node.hop_ms['p99']:.2f}",
    )  # fmt: skip


def _box_row(label: str, other: wire.BoxState) -> tuple[str, ...]:
    ahead = f"{other.clock_ahead_ms:.3f} ± {other.clock_error_ms:.3f} ms"
    lost = f"[red]lost for {other.lost_for_s:.0f} s[/]" if other.lost else "there"
    return (
        label, other.label, lost, f"{other.round_trip_ms:.2f} ms",
        ahead if other.clock_error_ms else "not known",
    )  # fmt: skip
