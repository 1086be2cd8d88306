"""What hosts say of themselves, as tables: names and sentences from outside stand as they came."""

from collections.abc import Iterator, Mapping, Sequence

from rich.console import Group
from rich.table import Table
from rich.text import Text

from pipeline.protocol.fleet import EdgeState, HostState, NodeState, State
from pipeline.terminal import brief, lean_table, losses, pair, rest

Said = Sequence[State] | str  # of one host: what runs there, or why that is not known
LOST = "lost"
Cell = str | Text


def condition(said: Said) -> str:
    """Of a host, for the nodes of which it says nothing: `lost`, `gone` or its part's phase."""
    if isinstance(said, str):
        return LOST
    return said[0].phase if said else "gone"


def absent(said: Said, nodes: Sequence[str]) -> list[str]:
    """The nodes that were brought up on a host and are in none of its processes now."""
    states = () if isinstance(said, str) else said
    there = {name for state in states for process in state.processes for name in process.nodes}
    return [name for name in nodes if name not in there]


def nodes_of(nodes: Mapping[str, str], label: str) -> list[str]:
    """Of nodes by label, those of a host."""
    return [node for node, host in nodes.items() if host == label]


def silence(why: str, nodes: Sequence[str]) -> str:
    """Why a host says nothing, and which nodes are lost with it."""
    return f"{why}; {LOST}: {', '.join(nodes)}" if nodes else why


def process_table() -> Table:
    """An empty one; `process_rows` fills it."""
    return lean_table(
        "hosts", names=("graph", "host"), words=("state", "process", "nodes"),
        figures=("pid", "CPU s", "RSS MB", "restarts"),
    )  # fmt: skip


def process_rows(label: str, said: Said, nodes: Sequence[str]) -> Iterator[tuple[Cell, ...]]:
    """Every process of a host, and every node there that should run and does not."""
    if not said or isinstance(said, str):
        yield (label, _red(condition(said), f" {said or ''}"), *[""] * 6)
    for state in () if isinstance(said, str) else said:
        yield (label, _told(state), *[""] * 6)
        for process in state.processes:
            yield (
                "", "", process.name, ", ".join(process.nodes), str(process.pid),
                f"{process.cpu_s:.1f}", f"{process.rss_mb:.0f}", str(process.restarts),
            )  # fmt: skip
    for node in absent(said, nodes):
        yield ("", _red(condition(said)), "", node, *[""] * 4)


def top_tables(
    before: Mapping[str, Said], now: Mapping[str, Said], seconds: float, nodes: Mapping[str, str]
) -> Group:
    """Edges, nodes and clocks of all hosts; `nodes`: node -> label, as they were brought up."""
    accounts = ("Hz", "offered", "rest", "age ms")
    edges = lean_table("edges, p50", names=("from", "to", "host"), figures=accounts)
    work = ("handled", "handler ms", "hop ms")
    table = lean_table("nodes, p50/p99", names=("node", "host"), words=("state",), figures=work)
    clock = ("round trip", "its clock is ahead")
    hosts = lean_table("hosts", names=("host", "sees"), words=("",), figures=clock)
    told: list[Text] = []
    earlier = {
        (label, edge.end): edge.sent
        for label, said in before.items()
        for state in ([] if isinstance(said, str) else said)
        for edge in state.edges
    }
    for label, said in now.items():
        if isinstance(said, str):
            _add(hosts, label, "", _red(LOST), "", "")
        for state in () if isinstance(said, str) else said:
            for edge in state.edges:
                _add(edges, *_edge_row(label, edge, earlier, seconds))
                told += losses(edge.origin, edge.end, edge.account, broken=edge.broken)
            for node in state.nodes:
                _add(table, *_node_row(label, node))
            for other in state.hosts:
                _add(hosts, *_host_row(label, other))
        for name in absent(said, nodes_of(nodes, label)):
            _add(table, name, label, _red(condition(said)), "", "", "")
    return Group(edges, *told, table, hosts)


def add_rows(table: Table, graph: str, rows: Iterator[tuple[Cell, ...]]) -> None:
    """Rows of a graph."""
    for row in rows:
        _add(table, graph, *row)


def _add(table: Table, *cells: Cell) -> None:
    """What comes from outside is no markup: `[/dev/video0]` would end a style that never began."""
    table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in cells))


def _red(word: str, rest: str = "") -> Text:
    return Text.assemble((word, "red"), rest)


def _told(state: State) -> Text:
    said = _red(state.phase, f" {state.failure}") if state.failure else Text(state.phase)
    away = [host.label for host in state.hosts if host.lost]
    return said.append(f", does not see {', '.join(away)}") if away else said


def _edge_row(
    label: str, edge: EdgeState, earlier: Mapping[tuple[str, str], int], seconds: float
) -> tuple[Cell, ...]:
    rate = (edge.sent - earlier.get((label, edge.end), edge.sent)) / seconds
    error = f" ± {edge.age_error_ms:.1f}" if edge.age_error_ms else ""
    return (
        edge.origin, edge.end, label, f"{rate:.1f}", str(edge.account["offered"]),
        rest(edge.account), f"{brief(edge.age_ms['p50'])}{error}",
    )  # fmt: skip


def _node_row(label: str, node: NodeState) -> tuple[Cell, ...]:
    return (
        node.name, label, node.condition, str(node.handled),
        pair(node.handler_ms), pair(node.hop_ms),
    )  # fmt: skip


def _host_row(label: str, other: HostState) -> tuple[Cell, ...]:
    ahead = f"{other.clock_ahead_ms:.3f} ± {other.clock_error_ms:.3f} ms"
    lost = _red(f"lost for {other.lost_for_s:.0f} s") if other.lost else "there"
    return (
        label, other.label, lost, f"{other.round_trip_ms:.2f} ms",
        ahead if other.clock_error_ms else "not known",
    )  # fmt: skip
