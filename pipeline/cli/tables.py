"""Tables of running graphs, local or deployed; names and sentences are not interpreted."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from pipeline.client.graph_client import Said, Status
from pipeline.client.live_figures import Loop, live_figures, name_of
from pipeline.protocol.fleet import EdgeState, HostState, NodeState, Process, State
from pipeline.protocol.questions import Health, NodeSettings
from pipeline.terminal import brief, lean_table, losses, pair, rest

LOST = "lost"
BAR = 30  # characters of a budget
Cell = str | Text


def condition(said: Said) -> str:
    """Return the state of nodes without a report: `lost`, `gone` or the phase of the host."""
    if isinstance(said, str):
        return LOST
    return said[0].phase if said else "gone"


def absent(said: Said, nodes: Iterable[str]) -> list[str]:
    """Return the nodes that were started on a host and are in none of its processes now."""
    states = () if isinstance(said, str) else said
    there = {name for state in states for process in state.processes for name in process.nodes}
    return [name for name in nodes if name not in there]


def nodes_of(nodes: Mapping[str, str], label: str) -> list[str]:
    """Return the nodes of a host."""
    return [node for node, host in nodes.items() if host == label]


def process_table(found: Iterable[Status]) -> Table:
    """Return a table of all processes, and of silent hosts and missing nodes."""
    found = list(found)
    several = any(label for status in found for label in status.hosts)
    table = lean_table(
        names=("graph", *(["host"] if several else []), "process"), words=("state", "nodes"),
        figures=("pid", "CPU s", "RSS MB", "restarts", "crashes"),
        spare=("restarts", "crashes", "CPU s", "RSS MB", "nodes", "pid"),
    )  # fmt: skip
    for status in found:
        for label, said in status.hosts.items():
            for host, *cells in _process_rows(label, said, nodes_of(status.nodes, label)):
                _add(table, status.graph, *([host] if several else []), *cells)
    return table


def unreached(status: Status) -> Iterator[str]:
    """Yield why hosts of a graph are lost; if all are, also the command that forgets it."""
    whys = [said for said in status.hosts.values() if isinstance(said, str)]
    yield from (f"{status.graph}: {why}" for why in dict.fromkeys(whys))
    if whys and len(whys) == len(status.hosts):
        yield f"{status.graph}: `fovea down {status.graph} --forget` takes it off this list"


def top_tables(before: Status, now: Status, seconds: float) -> Group:
    """Return the loop's budget, and tables of edges, nodes, processes and, if several, hosts.

    Rates and processor time are those since `before`.
    """
    several, live = any(now.hosts), live_figures(before, now, seconds)
    where = ["host"] if several else []
    edges = lean_table(
        "edges, p50", names=("from", "to", *where),
        figures=("Hz", "offered", "delivered", "rest", "age ms"),
        spare=("delivered", "offered", *where, "rest", "age ms", "Hz"),
    )  # fmt: skip
    nodes = lean_table(
        "nodes, p50/p99", names=("node", *where), words=("state", "on"),
        figures=("epoch", "handled", "last seq", "handler ms", "hop ms"),
        spare=("last seq", "hop ms", "epoch", "handled", "on", *where, "handler ms"),
    )  # fmt: skip
    clocks = ("round trip", "its clock is ahead")
    hosts = lean_table("hosts", names=("host", "sees"), words=("",), figures=clocks)
    processes = lean_table(
        "processes", names=("process", *where), words=("nodes",),
        figures=("CPU %", "RSS MB", "restarts", "crashes"),
        spare=("crashes", "nodes", *where, "restarts"),
    )  # fmt: skip
    told: list[Text] = []
    for label, said in now.hosts.items():
        here = [label] if several else []
        if isinstance(said, str):
            _add(hosts, label, "", _red(LOST), "", "")
        for state in () if isinstance(said, str) else said:
            for edge in state.edges:
                rate = live.edge_hz.get(name_of(label, edge.end), 0.0)
                _add(edges, edge.origin, edge.end, *here, *_edge_cells(edge, rate))
                told += losses(edge.origin, edge.end, edge.account, broken=edge.broken)
            for node in state.nodes:
                _add(nodes, node.name, *here, *_node_cells(node))
            for process in state.processes:
                percent = live.cpu_percent.get(name_of(label, process.name))
                _add(processes, process.name, *here, *_process_cells(process, percent))
            for other in state.hosts:
                _add(hosts, *_host_cells(label, other))
        for name in absent(said, nodes_of(now.nodes, label)):
            _add(nodes, name, *here, _red(condition(said)), *[""] * 6)
    above = loop_lines(live.loop) if live.loop else []
    return Group(*above, edges, *told, nodes, processes, *([hosts] if several else []))


def loop_lines(loop: Loop) -> list[Text]:
    """Return the loop's percentiles, each as a bar of its budget; red: over it."""
    lines = []
    for name, latency_ms in loop.latency_ms.items():
        budget_ms = loop.budget_ms.get(name)
        if budget_ms is None:
            lines.append(Text(f"loop {name} {brief(latency_ms)} ms"))
            continue
        full = min(BAR, round(BAR * latency_ms / budget_ms))
        over = latency_ms > budget_ms
        lines.append(
            Text.assemble(
                f"loop {name} ", ("█" * full, "red" if over else "green"), "░" * (BAR - full),
                f" {brief(latency_ms)} of {brief(budget_ms)} ms{', over its budget' * over}",
            )
        )  # fmt: skip
    return lines


def health_table(found: Mapping[str, Mapping[str, Health | None]]) -> Table:
    """Return a table with the state and problems of every node."""
    table = lean_table(
        names=("graph", "node"), words=("state", "what is wrong", "what it says"),
        figures=("pid", "epoch", "frame", "own MB"),
        spare=("epoch", "own MB", "pid", "frame"),
    )  # fmt: skip
    for graph, nodes in found.items():
        for node, health in nodes.items():
            if health is None:
                _add(table, graph, node, "", _red("no answer"), *[""] * 5)
                continue
            broken = [f"{end} lost messages it was promised" for end in health.broken]
            wrong = "; ".join(filter(None, [health.problem, *broken]))
            _add(
                table, graph, node, health.state, wrong, health.words, str(health.pid),
                str(health.epoch), str(health.last_seq), f"{health.own_mb:.0f}",
            )  # fmt: skip
    return table


def settings_table(answer: NodeSettings) -> Table:
    """Return a table of a node's settings and whether each is live."""
    table = lean_table(names=("setting",), words=("value", "live"), spare=("live",))
    for name, value in answer.settings.items():
        _add(table, name, json.dumps(value), "yes" if name in answer.live else "")
    return table


def live_line(status: Status) -> str:
    """Return one line with a graph's progress, rate and losses."""
    states = [
        state for said in status.hosts.values() if not isinstance(said, str) for state in said
    ]
    nodes = [node for state in states for node in state.nodes]
    edges = [edge for state in states for edge in state.edges]
    loop = max((node.loop_ms for node in nodes), key=lambda times: times["p50"], default=None)
    broken = [edge.end for edge in edges if edge.broken]
    silent = [label for label, said in status.hosts.items() if isinstance(said, str)]
    parts = [
        f"frame {max((node.last_seq for node in nodes), default=0)}",
        *([f"loop {pair(loop)} ms p50/p99"] if loop else []),
        f"dropped {sum(sum(edge.account['dropped'].values()) for edge in edges)}",
        *([f"broken: {', '.join(broken)}"] if broken else []),
        *([f"lost: {', '.join(silent)}"] if silent else []),
    ]
    return "  ".join(parts)


def _process_rows(label: str, said: Said, nodes: Sequence[str]) -> Iterator[tuple[Cell, ...]]:
    """Yield rows of processes and of missing nodes: host, process, state, nodes and figures.

    A host with anything to report but that its part runs has a row of its own.
    """
    figures = [""] * 5
    if not said or isinstance(said, str):
        yield (label, "", _red(condition(said)), "", *figures)
    for state in () if isinstance(said, str) else said:
        if label:
            yield (label, "", _told(state), "", *figures)
        for process in state.processes:
            words = "" if label else _phase(process, state)
            seen = Text(words) if process.pid else _red("gone")
            yield (
                "" if label else label, process.name, seen, ", ".join(process.nodes),
                *([str(process.pid), f"{process.cpu_s:.1f}", f"{process.rss_mb:.0f}"]
                  if process.pid else [""] * 3),
                str(process.restarts), str(process.crashes),
            )  # fmt: skip
    for node in absent(said, nodes):
        yield ("", "", _red(condition(said)), node, *figures)


def _phase(process: Process, state: State) -> str:
    """Return whether a process runs or starts, by its own nodes: those of others may be away."""
    opened = (node.opened for node in state.nodes if node.name in process.nodes)
    return "running" if all(opened) else "starting"


def _add(table: Table, *cells: Cell) -> None:
    """Add untrusted cells without markup: Rich would read `[/dev/video0]` as a closing tag."""
    table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in cells))


def _red(word: str, rest: str = "") -> Text:
    return Text.assemble((word, "red"), rest)


def _told(state: State) -> Text:
    said = _red(state.phase, f" {state.failure}") if state.failure else Text(state.phase)
    away = [host.label for host in state.hosts if host.lost]
    return said.append(f", does not see {', '.join(away)}") if away else said


def _edge_cells(edge: EdgeState, rate: float) -> tuple[Cell, ...]:
    error = f" ± {edge.age_error_ms:.1f}" if edge.age_error_ms else ""
    account = edge.account
    return (
        f"{rate:.1f}", str(account["offered"]), str(account["delivered"]), rest(account),
        f"{brief(edge.age_ms['p50'])}{error}",
    )  # fmt: skip


def _node_cells(node: NodeState) -> tuple[Cell, ...]:
    return (
        node.condition, node.provider, str(node.epoch), str(node.handled), str(node.last_seq),
        pair(node.handler_ms), pair(node.hop_ms),
    )  # fmt: skip


def _process_cells(process: Process, percent: float | None) -> tuple[Cell, ...]:
    return (
        ", ".join(process.nodes), "" if percent is None else f"{percent:.0f}",
        f"{process.rss_mb:.0f}" if process.pid else "", str(process.restarts), str(process.crashes),
    )  # fmt: skip


def _host_cells(label: str, other: HostState) -> tuple[Cell, ...]:
    ahead = f"{other.clock_ahead_ms:.3f} ± {other.clock_error_ms:.3f} ms"
    lost = _red(f"lost for {other.lost_for_s:.0f} s") if other.lost else "there"
    return (
        label, other.label, lost, f"{other.round_trip_ms:.2f} ms",
        ahead if other.clock_error_ms else "not known",
    )  # fmt: skip
