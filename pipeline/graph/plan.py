"""A checked graph, ready to run: nodes and edges with every default filled in.

The loader makes a plan; the supervisor sends it to node processes, the in-line runner uses it
directly. Wherever a plan comes from, this module refuses invalid names (`pipeline.naming`), numbers
outside `pipeline.graph.limits` and edges without ends.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

from pipeline.contract import Input, Keep, Operator, Source, inputs_of
from pipeline.declarations import check_declarations
from pipeline.errors import GraphError, SettingsError
from pipeline.graph.limits import EDGE, MOST_EDGES, MOST_NODES, NODE, RESTART, check_numbers
from pipeline.import_path import imported
from pipeline.naming import check_name
from pipeline.settings import suggest
from pipeline.wording import shown, shown_key

Clock = Literal["realtime", "lockstep"]
RestartPolicy = Literal["never", "on-failure", "always"]


@dataclass(frozen=True, kw_only=True)
class Restart:
    """The restart policy of a node: restarts allowed per window, with exponential back-off."""

    policy: RestartPolicy = "on-failure"
    backoff_s: float = 0.05
    window_s: float = 60.0
    most: int = 10  # restarts within the window; one more ends the run

    def __post_init__(self) -> None:
        check_numbers(self, RESTART, "", SettingsError)


@dataclass(frozen=True, kw_only=True)
class Edge:
    """A connection from an output to an input, with its options."""

    index: int
    source: str
    output: str
    target: str
    input: str
    keep: Keep
    depth: int
    join: bool
    optional: bool
    wait_ms: float
    max_age_ms: float
    stale: Literal["drop", "pass"]
    command: bool
    tap: bool
    transport: Literal["pool", "bytes"]

    def __post_init__(self) -> None:
        for name in (self.source, self.output, self.target, self.input):
            check_name(name, "edge")
        check_numbers(self, EDGE, self.end)

    @property
    def origin(self) -> str:
        """`node` or `node.output`, as a graph file writes it."""
        return self.source if self.output == "out" else f"{self.source}.{self.output}"

    @property
    def end(self) -> str:
        """`node.input`."""
        return f"{self.target}.{self.input}"


@dataclass(frozen=True, kw_only=True)
class Node:
    """One operator, its settings and the limits of its process."""

    index: int
    name: str
    operator: str  # import path module:Class
    settings: dict[str, Any]
    group: str = ""  # nodes of one group share a process
    host: str = ""
    threads: int = 1
    stall_s: float = 10.0  # a handler that runs longer is a stall
    start_s: float = 60.0  # time limit to open
    memory_mb: float = 0.0  # private memory; above it the node restarts; 0: no limit
    restart: Restart = field(default_factory=Restart)

    def __post_init__(self) -> None:
        check_name(self.name, "node")
        if self.group:
            check_name(self.group, f"{self.name}.group")
        if self.host:
            check_name(self.host, f"{self.name}.host")
        check_numbers(self, NODE, self.name)

    @property
    def process(self) -> str:
        """The name of its process."""
        return self.group or self.name


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A checked graph."""

    name: str
    clock: Clock
    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]
    hosts: tuple[str, ...] = ()  # labels of its hosts
    here: str = ""  # label of the host whose nodes this supervisor runs; empty: all nodes

    def __post_init__(self) -> None:
        check_name(self.name, "name")
        for host in self.hosts:
            check_name(host, "hosts")
        if self.here:
            check_name(self.here, "here")
        names, ends = {node.name for node in self.nodes}, {edge.end for edge in self.edges}
        if len(names) < len(self.nodes) or len(names) > MOST_NODES:
            raise GraphError(f"{self.name}: expected up to {MOST_NODES} nodes of different names")
        if len(ends) < len(self.edges) or len(ends) > MOST_EDGES:
            raise GraphError(f"{self.name}: expected up to {MOST_EDGES} edges, one for an input")
        for edge in self.edges:
            if not {edge.source, edge.target} <= names:
                raise GraphError(f"{edge.end}: expected an edge between two nodes")

    def is_here(self, node: Node) -> bool:
        """Whether this supervisor runs a node."""
        return not self.here or node.host == self.here

    def touches(self, edge: Edge) -> bool:
        """Whether an edge begins or ends at a node that this supervisor runs."""
        return self.is_here(self.node(edge.source)) or self.is_here(self.node(edge.target))

    def crosses(self, edge: Edge) -> bool:
        """Whether its two ends are on different hosts in this run."""
        return bool(self.here) and self.node(edge.source).host != self.node(edge.target).host

    def node(self, name: str) -> Node:
        """Return the node of that name."""
        return next(n for n in self.nodes if n.name == name)

    def inputs(self, node: str) -> dict[str, Edge]:
        """Return the edges into a node by input, in the order of the operator's declaration."""
        return {e.input: e for e in self.edges if e.target == node}

    def exposes(self, node: str) -> bool:
        """Whether a node is a source: nothing reaches it but commands."""
        return all(edge.command for edge in self.inputs(node).values())

    def readers(self, node: str, output: str) -> tuple[Edge, ...]:
        """Return the edges from one output."""
        return tuple(e for e in self.edges if e.source == node and e.output == output)

    def command_path(self) -> frozenset[str]:
        """Return the nodes on the path to the sensor's next command, sources included."""
        found = {edge.source for edge in self.edges if edge.command}
        grown = True
        while grown:
            before = len(found)
            deciding = (e for e in self.edges if e.join and not e.command and e.target in found)
            found |= {edge.source for edge in deciding}
            grown = len(found) > before
        return frozenset(found)

    def processes(self) -> dict[str, tuple[Node, ...]]:
        """Return the nodes here by process, in dependency order of each process's first node."""
        found: dict[str, list[Node]] = {}
        for name in self.order():
            node = self.node(name)
            if self.is_here(node):
                found.setdefault(node.process, []).append(node)
        return {name: tuple(nodes) for name, nodes in found.items()}

    def lossless(self, edge: Edge) -> bool:
        """Return whether the reader of an edge gets every message, as its writer waits for it.

        In real time nothing waits for a tap; one that keeps every message loses the oldest when
        more than `depth` of them wait.
        """
        return edge.keep == "every" and (self.clock == "lockstep" or not edge.tap)

    def _waits(self, edge: Edge) -> bool:
        """Return whether the writer of an edge may have to wait for its reader."""
        return self.clock == "realtime" and self.lossless(edge)

    def order(self) -> tuple[str, ...]:
        """Return node names, writers before readers.

        Command edges do not count; nor do those of a loop for which nothing waits, such as feedback
        from a consumer to a policy. In real time the writer of a lossless edge waits for its
        reader; in lockstep a frame is answered before the next one, so that no queue fills.
        """
        edges = [edge for edge in self.edges if not edge.command]
        waiting = {node.name for node in self.nodes}
        done: list[str] = []
        while waiting:
            blocked = {e.target for e in edges if e.source in waiting and e.target in waiting}
            if free := [n.name for n in self.nodes if n.name in waiting - blocked]:
                done += free
                waiting -= set(free)
                continue
            joined = [
                e for e in edges
                if e.join or self._waits(e) or not {e.source, e.target} <= waiting
            ]  # fmt: skip
            if len(joined) == len(edges):
                raise GraphError(
                    f"nodes {', '.join(sorted(waiting))} wait for one another: expected a sensor "
                    "command or an unjoined input that may lose in every loop, got none"
                )
            edges = joined
        return tuple(done)


def slots(readers: tuple[Edge, ...]) -> int:
    """Return the pool slots of an output: those readers may hold, one in hand, two to write."""
    return 2 + sum(_held(edge) + 1 for edge in readers)


def inputs_for(plan: Plan, node: Node) -> dict[str, Input]:
    """Return a node's connected inputs with the options of the graph file."""
    operator = load_operator(node.operator)
    edges = plan.inputs(node.name)
    return {name: _effective(operator, edges[name], plan.clock) for name in edges}


def load_operator(path: str, where: str = "") -> type[Operator[Any, Any]]:
    """Import `module:Class`; raises `GraphError`, beginning with `where`, for no valid operator."""
    try:
        found = imported(path, GraphError)
        if not (isinstance(found, type) and issubclass(found, Operator)):
            raise GraphError(f"{path}: expected an Operator, got {shown(found)}")
        check_declarations(found)
    except GraphError as error:
        raise GraphError(f"{where}: {error}" if where else str(error)) from error
    return found


def is_source(node: Node) -> bool:
    """Whether the node is a source."""
    return issubclass(load_operator(node.operator), Source)


def no_output(origin: str, outputs: Iterable[str]) -> str:
    """Return why `node` or `node.output` is none of the node's outputs, as a sentence.

    >>> no_output("eye", ["context", "roi"]), no_output("eye.rio", ["context", "roi"])
    ('eye has several outputs, name one: eye.context, eye.roi', \
"eye has no output rio, did you mean 'eye.roi'?")
    """
    node, _, output = origin.partition(".")
    known = [node if name == "out" else f"{node}.{name}" for name in outputs]
    if known and not output:
        what = "several outputs, name one" if len(known) > 1 else "one output, name it"
        return f"{node} has {what}: {', '.join(known)}"
    return f"{node} has no output {shown_key(output or 'out')}{suggest(origin, known)}"


def sources(plan: Plan) -> Iterator[Node]:
    """Yield the source nodes."""
    return (node for node in plan.nodes if is_source(node))


def _held(edge: Edge) -> int:
    if edge.keep == "every" or edge.join:
        return edge.depth
    return 1


def _effective(operator: type[Operator[Any, Any]], edge: Edge, clock: Clock) -> Input:
    return Input(
        inputs_of(operator)[edge.input].message,
        keep="every" if clock == "lockstep" else edge.keep,
        depth=edge.depth,
        join=edge.join,
        optional=edge.optional,
        wait_ms=edge.wait_ms,
        max_age_ms=edge.max_age_ms,
        stale=edge.stale,
        command=edge.command,
        tap=edge.tap,
    )
