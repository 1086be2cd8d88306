"""Which part of a graph runs on which host, and whether a host may run its part.

Of a plan that came over the wire first the form is checked, then code, settings and ports of the
nodes here. The operators of other hosts are never loaded.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pipeline import codec
from pipeline import settings as checked
from pipeline.contract import inputs_of, outputs_of, settings_of
from pipeline.errors import GraphError
from pipeline.fleet.allow import Allowed
from pipeline.fleet.names import node_identity
from pipeline.fleet.validation import validate_plan
from pipeline.graph.plan import Node, Plan, load_operator
from pipeline.graph.ports import check_ports


def plan_for(plan: Plan, label: str) -> Plan:
    """The plan as the host of that label runs it: edges to other hosts carry bytes."""
    local = replace(plan, here=label)
    edges = tuple(replace(e, transport="bytes") if local.crosses(e) else e for e in plan.edges)
    return replace(local, edges=edges)


def check_labels(plan: Plan, labels: Mapping[str, Any]) -> None:
    """Raise `GraphError` unless there is a host for every label, and time is real."""
    if plan.clock == "lockstep":
        raise GraphError(f"{plan.name}: lockstep runs on one host, got several")
    used = {node.host for node in plan.nodes}
    if used == {""}:
        raise GraphError(f"{plan.name}: expected a `host` label at every node, got none")
    for label in sorted(used):
        if label not in labels:
            raise GraphError(
                f"{plan.name}: no host {label} among the agents found"
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


def identities(plan: Plan, label: str) -> list[str]:
    """The nodes of a host that have credentials: those with an edge to another one."""
    crossing = borders(plan)
    here = [node for node in plan.nodes if node.host == label and place(node) in crossing]
    return list(dict.fromkeys(node_identity(plan.name, node) for node in here))


def listeners(plan: Plan, label: str) -> list[str]:
    """The processes of a host that listen: of two that speak, the first by name does."""
    found = borders(plan)
    return [
        name.partition("/")[2]
        for name, others in found.items()
        if name.partition("/")[0] == label and any(name < other for other in others)
    ]


def fingerprints(plan: Plan, label: str = "") -> dict[str, str]:
    """The fingerprints of what every output sends; of one host, what its nodes send and expect."""
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
    """The plan that a host would run, with its own settings; raises for what may not run."""
    validate_plan(plan, label)
    nodes = []
    for node in plan.nodes:
        if node.host == label:
            node = replace(node, settings=_inspected(node, allowed, over.get(node.name, {})))
        nodes.append(node)
    local = plan_for(replace(plan, nodes=tuple(nodes)), label)
    check_ports(plan, lambda node: node.host == label)
    local.order()
    return local


def check_fingerprints(plan: Plan, label: str, theirs: Mapping[str, str]) -> None:
    """Raise `GraphError` where this host would read or write another message than is meant."""
    for origin, mine in fingerprints(plan, label).items():
        if theirs.get(origin) != mine:
            raise GraphError(
                f"{origin}: expected messages of schema {theirs.get(origin, 'none')}, got {mine} "
                "here; install the same version on all hosts"
            )


def _inspected(node: Node, allowed: Allowed, own: Mapping[str, Any]) -> dict[str, Any]:
    allowed.check_code(node.operator, f"{node.name}.operator")
    foreign = {k: v for k, v in node.settings.items() if k not in own}
    values = {**allowed.localise(foreign, node.name), **own}
    checked.build(settings_of(load_operator(node.operator)), values, node.name)
    return values
