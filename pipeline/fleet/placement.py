"""Which part of a graph runs on which box, and whether a box may run its part.

A plan that came over the wire is looked at from the ground up: names, numbers, code, settings,
ports. The operators of other boxes are never loaded.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pipeline import codec
from pipeline import settings as checked
from pipeline.bus.clocks import MOST_HOSTS
from pipeline.contract import inputs_of, outputs_of, settings_of
from pipeline.errors import GraphError, SettingsError
from pipeline.fleet.allow import Allowed
from pipeline.fleet.names import check_label, check_name
from pipeline.graph.plan import Edge, Node, Plan, load_operator

MOST_NODES, MOST_EDGES = 128, 512
_PORT = re.compile(r"[A-Za-z_]\w{0,62}")


def part_of(plan: Plan, label: str) -> Plan:
    """The plan as the box of that label runs it: edges to other hosts carry bytes."""
    part = replace(plan, here=label)
    edges = tuple(replace(e, transport="bytes") if part.crosses(e) else e for e in plan.edges)
    return replace(part, edges=edges)


def check_labels(plan: Plan, labels: Mapping[str, Any]) -> None:
    """Raise `GraphError` unless there is a box for every label, and time is real."""
    if plan.clock == "lockstep":
        raise GraphError(f"{plan.name}: lockstep runs on one host, got several boxes")
    used = {node.host for node in plan.nodes}
    if used == {""}:
        raise GraphError(f"{plan.name}: expected a `host` label at every node, got none")
    for label in sorted(used):
        if label not in labels:
            raise GraphError(
                f"{plan.name}: no box {label} among the agents found"
                f"{checked.suggest(label, labels)}"
            )


def borders(plan: Plan) -> dict[str, frozenset[str]]:
    """The processes with an edge to another host, as `label/process`: with whom each speaks."""
    found: dict[str, set[str]] = {}
    for edge in plan.edges:
        source, target = plan.node(edge.source), plan.node(edge.target)
        if source.host != target.host:
            found.setdefault(place(source), set()).add(place(target))
            found.setdefault(place(target), set()).add(place(source))
    return {name: frozenset(others) for name, others in found.items()}


def place(node: Node) -> str:
    """`label/process`."""
    return f"{node.host}/{node.process}"


def listeners(plan: Plan, label: str) -> list[str]:
    """The processes of a box that listen: of two that speak, the first by name does."""
    found = borders(plan)
    return [
        name.partition("/")[2]
        for name, others in found.items()
        if name.partition("/")[0] == label and any(name < other for other in others)
    ]


def marks(plan: Plan, label: str = "") -> dict[str, str]:
    """The fingerprints of what every output sends; of one box, what its nodes send and expect."""
    found: dict[str, str] = {}
    for edge in plan.edges:
        for node, read in ((edge.source, False), (edge.target, True)):
            if label and plan.node(node).host != label:
                continue
            operator = load_operator(plan.node(node).operator)
            message = (
                inputs_of(operator)[edge.input].message
                if read
                else outputs_of(operator)[edge.output]
            )
            found[edge.origin] = codec.fingerprint(message).hex()
    return found


def inspect(plan: Plan, label: str, allowed: Allowed, over: Mapping[str, Any]) -> Plan:
    """The part a box would run, its settings those of this box; raises for what may not run."""
    _check_form(plan, label)
    nodes = []
    for node in plan.nodes:
        if node.host == label:
            node = replace(node, settings=_inspected(node, allowed, over.get(node.name, {})))
        nodes.append(node)
    part = part_of(replace(plan, nodes=tuple(nodes)), label)
    for edge in plan.edges:
        _check_ends(plan, edge, label)
    part.order()
    return part


def check_marks(plan: Plan, label: str, theirs: Mapping[str, str]) -> None:
    """Raise `GraphError` where this box would read or write another message than is meant."""
    for origin, mine in marks(plan, label).items():
        if theirs.get(origin) != mine:
            raise GraphError(
                f"{origin}: expected messages of schema {theirs.get(origin, 'none')}, got {mine} "
                "here; install the same version on all boxes"
            )


def _inspected(node: Node, allowed: Allowed, own: Mapping[str, Any]) -> dict[str, Any]:
    allowed.check_code(node.operator, f"{node.name}.operator")
    foreign = {k: v for k, v in node.settings.items() if k not in own}
    values = {**allowed.localise(foreign, node.name), **own}
    checked.build(settings_of(load_operator(node.operator)), values, node.name)
    return values


def _check_form(plan: Plan, label: str) -> None:
    check_name(plan.name, "name")
    if plan.clock != "realtime":
        raise GraphError(f"{plan.name}: clock: expected realtime between hosts, got {plan.clock}")
    if not 0 < len(plan.nodes) <= MOST_NODES or len(plan.edges) > MOST_EDGES:
        raise GraphError(
            f"{plan.name}: expected 1 to {MOST_NODES} nodes and up to {MOST_EDGES} edges, got "
            f"{len(plan.nodes)} and {len(plan.edges)}"
        )
    if len(plan.hosts) > MOST_HOSTS or label not in plan.hosts or plan.here:
        raise GraphError(f"{plan.name}: hosts: expected {label} among them, got {plan.hosts}")
    for host in plan.hosts:
        check_label(host, "hosts")
    names = set()
    for index, node in enumerate(plan.nodes):
        check_name(node.name, "nodes")
        check_name(node.process, f"{node.name}.group")
        if node.index != index or node.name in names or node.host not in plan.hosts:
            raise GraphError(f"{node.name}: expected a node with a place of its own")
        names.add(node.name)
    for index, edge in enumerate(plan.edges):
        if edge.index != index or not {edge.source, edge.target} <= names:
            raise GraphError(f"{edge.end}: expected an edge between two nodes")
        if not _PORT.fullmatch(edge.input) or not _PORT.fullmatch(edge.output):
            raise GraphError(f"{edge.end}: expected names of ports")
        if not 1 <= edge.depth <= 64 or (edge.command and edge.keep != "latest"):
            raise GraphError(f"{edge.end}: expected a depth of 1 to 64, latest for a command")


def _check_ends(plan: Plan, edge: Edge, label: str) -> None:
    """The ports here exist and are what the edge says."""
    if plan.node(edge.source).host == label:
        outputs = outputs_of(load_operator(plan.node(edge.source).operator))
        if edge.output not in outputs:
            hint = checked.suggest(edge.output, outputs)
            raise GraphError(f"{edge.source}: no output {edge.output}{hint}")
    if plan.node(edge.target).host == label:
        inputs = inputs_of(load_operator(plan.node(edge.target).operator))
        if edge.input not in inputs:
            hint = checked.suggest(edge.input, inputs)
            raise GraphError(f"{edge.target}: no input {edge.input}{hint}")
        port = inputs[edge.input]
        same = ("join", "optional", "command", "tap")
        if any(getattr(port, name) != getattr(edge, name) for name in same):
            raise SettingsError(f"{edge.end}: expected the input as it is declared")
