"""Parse a graph file and check all that needs no import of its operators.

Keys, names, numbers, choices and hosts are checked here; operators, settings and message types by
the loader.
"""

import difflib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

from pipeline import settings as checked
from pipeline.bus.clocks import MOST_HOSTS
from pipeline.contract import Keep
from pipeline.errors import GraphError, SettingsError
from pipeline.graph.limits import EDGE, MOST_NODES, NODE
from pipeline.graph.plan import Clock, Restart
from pipeline.graph.yaml_lines import YamlFile, kind_of, plain
from pipeline.import_path import check_import_path, is_import_path
from pipeline.naming import GRAMMAR, check_name
from pipeline.wording import shown, shown_key

GRAPH_KEYS = ("name", "clock", "hosts", "nodes")
NODE_KEYS = ("operator", "inputs", "settings", "group", "host", "threads", "stall_s", "start_s",
             "memory_mb", "restart", "manual")  # fmt: skip
EDGE_KEYS = ("from", "keep", "depth", "wait_ms", "max_age_ms", "stale", "transport")
ORIGIN = rf"{GRAMMAR}(\.{GRAMMAR})?"  # node or node.output
CLOCKS: tuple[str, ...] = get_args(Clock)
CHOICES: Mapping[str, tuple[str, ...]] = {
    "keep": get_args(Keep), "stale": ("drop", "pass"), "transport": ("pool", "bytes")
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class EdgeSpec:
    """An input of a node as a graph file writes it."""

    place: str  # file:line
    where: str  # node.inputs.input
    origin: str  # as written: node or node.output
    given: Mapping[str, Any]  # the given ones of keep, depth, …

    @property
    def source(self) -> str:
        """The writing node."""
        return self.origin.partition(".")[0]

    @property
    def output(self) -> str:
        """The output of that node."""
        return self.origin.partition(".")[2] or "out"


@dataclass(frozen=True, kw_only=True)
class NodeSpec:
    """A node as a graph file writes it."""

    name: str
    entry: Mapping[str, Any]  # as read, to look up line numbers
    operator: str
    inputs: Mapping[str, EdgeSpec]
    settings: dict[str, Any]
    given: Mapping[str, Any] = field(default_factory=dict)  # the given ones of group, threads, …
    restart: Restart
    manual: bool

    @property
    def host(self) -> str:
        """The label of its host, or an empty string."""
        return str(self.given.get("host", ""))

    @property
    def process(self) -> str:
        """The name of its process."""
        return str(self.given.get("group", self.name))


@dataclass(frozen=True, kw_only=True)
class GraphSpec:
    """A graph as its file writes it."""

    name: str
    clock: Clock
    hosts: tuple[str, ...]
    nodes: Mapping[str, NodeSpec]


def graph_spec(file: YamlFile, clock: str = "") -> GraphSpec:
    """Parse a file, replacing its clock if one is given; raises `FoveaError` with the line."""
    document = file.document
    file.only(document, GRAPH_KEYS, "graph")
    clock = clock or document.get("clock", "realtime")
    if clock not in CLOCKS:
        file.fail(document, "clock", f"clock: expected {' or '.join(CLOCKS)}, got {shown(clock)}")
    nodes = file.mapping(document, "nodes", "graph")
    if not 0 < len(nodes) <= MOST_NODES:
        file.fail(document, "nodes", f"nodes: expected 1 to {MOST_NODES}, got {len(nodes)}")
    return GraphSpec(
        name=_graph_name(file),
        clock="lockstep" if clock == "lockstep" else "realtime",
        hosts=_hosts(file),
        nodes=node_specs(file, nodes),
    )


def node_specs(file: YamlFile, nodes: Mapping[str, Any]) -> dict[str, NodeSpec]:
    """Parse the nodes of a file; raises `FoveaError` with file and line."""
    for name in nodes:
        check_name(name, f"{file.at(nodes, name)}: nodes")
    return {name: _node(file, nodes, name) for name in nodes}


def check_places(file: YamlFile, nodes: Mapping[str, NodeSpec], hosts: tuple[str, ...]) -> None:
    """Check that all nodes or none have a known host, and that a group is on one host."""
    hosts_of: dict[str, str] = {}
    for node in nodes.values():
        if node.host not in hosts and (node.host or hosts):
            got = f"no host {node.host}" if node.host else "expected a host, got none"
            hint = checked.suggest(node.host, hosts) if hosts else ""
            say = hint or "; the graph names its hosts with `hosts: [label, …]`"
            file.fail(node.entry, "host", f"{node.name}.host: {got}{say}")
        if hosts_of.setdefault(node.process, node.host) != node.host:
            what = f"{node.name}.host: group {node.process} is on {hosts_of[node.process]}"
            file.fail(node.entry, "host", f"{what}, got {node.host}")


def import_paths(value: Any) -> Iterator[str]:
    """Yield all strings in a value with the form of import paths, which settings may import."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from import_paths(item)
    elif is_import_path(value):
        yield value


def _graph_name(file: YamlFile) -> str:
    if "name" in file.document:
        return check_name(file.document["name"], f"{file.at(file.document, 'name')}: name")
    where = f"{file.path}:1: name: the graph has none, and that of its file will not do"
    return check_name(file.path.stem, where)


def _hosts(file: YamlFile) -> tuple[str, ...]:
    """Return the host labels that nodes may use."""
    labels = file.document.get("hosts")
    labels = [] if labels is None else labels
    if not isinstance(labels, list):
        file.fail(file.document, "hosts", f"hosts: expected a list, got {kind_of(labels)}")
    place = file.at(file.document, "hosts")
    names = tuple(check_name(label, f"{place}: hosts") for label in labels)
    if len(set(names)) < len(names) or len(names) > MOST_HOSTS:
        file.fail(file.document, "hosts", f"hosts: expected up to {MOST_HOSTS} different names")
    return names


def _node(file: YamlFile, nodes: Mapping[str, Any], name: str) -> NodeSpec:
    entry = file.mapping(nodes, name, "nodes")
    file.only(entry, NODE_KEYS, name)
    where = f"{file.at(entry, 'operator')}: {name}.operator"
    manual = entry.get("manual", False)
    if not isinstance(manual, bool):
        what = f"{name}.manual: expected true or false, got {shown(manual)}"
        file.fail(entry, "manual", what)
    return NodeSpec(
        name=name,
        entry=entry,
        operator=check_import_path(entry.get("operator"), where, GraphError),
        inputs=_inputs(file, entry, name),
        settings=plain(_optional_mapping(file, entry, "settings", name)),
        given=_given(file, entry, name),
        restart=_restart(file, entry, name),
        manual=manual,
    )


def _optional_mapping(file: YamlFile, entry: Mapping[str, Any], key: str, name: str) -> Any:
    """Return an optional mapping."""
    return {} if entry.get(key) is None else file.mapping(entry, key, name)


def _given(file: YamlFile, entry: Mapping[str, Any], name: str) -> dict[str, Any]:
    given: dict[str, Any] = {}
    for key in ("group", "host"):
        if key in entry:
            given[key] = check_name(entry[key], f"{file.at(entry, key)}: {name}.{key}")
    for key, limit in NODE.items():
        if key in entry:
            given[key] = limit.read(entry[key], f"{file.at(entry, key)}: {name}.{key}")
    return given


def _restart(file: YamlFile, entry: Mapping[str, Any], name: str) -> Restart:
    value = entry.get("restart", {})
    where = f"{file.at(entry, 'restart')}: {name}.restart"
    if isinstance(value, str):
        return checked.build(Restart, {"policy": value}, where)
    if not isinstance(value, Mapping):
        raise GraphError(f"{where}: expected a policy or a mapping, got {kind_of(value)}")
    try:
        return checked.build(Restart, plain(value), f"{name}.restart")
    except checked.WrongSetting as error:
        raise SettingsError(f"{file.deepest(value, error.path)}: {error}") from error


def _inputs(file: YamlFile, entry: Mapping[str, Any], name: str) -> dict[str, EdgeSpec]:
    inputs = _optional_mapping(file, entry, "inputs", name)
    for key in inputs:
        check_name(key, f"{file.at(inputs, key)}: {name}.inputs")
    return {key: _edge(file, inputs, key, f"{name}.inputs.{key}") for key in inputs}


def _edge(file: YamlFile, inputs: Mapping[str, Any], key: str, where: str) -> EdgeSpec:
    value = inputs[key]
    long = value if isinstance(value, Mapping) else {"from": value}
    file.only(long, EDGE_KEYS, where)
    place = file.at(inputs, key)
    origin = long.get("from")
    if not isinstance(origin, str) or not re.fullmatch(ORIGIN, origin):
        raise GraphError(f"{place}: {where}: expected node or node.output, got {shown(origin)}")
    given = {k: v for k, v in long.items() if k != "from"}
    for option, allowed in CHOICES.items():
        if option in given and given[option] not in allowed:
            near = difflib.get_close_matches(str(given[option])[:40], allowed, 1)
            also = f", did you mean {near[0]}?" if near else ""
            what = f"{where}.{option}: expected {' or '.join(allowed)}, got {shown(given[option])}"
            file.fail(long, option, what + also)
    for option, limit in EDGE.items():
        if option in given:
            at = file.at(long, option) if long is value else place
            given[option] = limit.read(given[option], f"{at}: {where}.{shown_key(option)}")
    return EdgeSpec(place=place, where=where, origin=origin, given=given)
