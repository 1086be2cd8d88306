"""Validation of a plan that came over the wire, beyond what holds for every plan.

Names, numbers and the ends of edges are checked with the plan. Nothing of it is loaded for this.
"""

from pipeline.bus.clocks import MOST_HOSTS
from pipeline.bus.ledger import ROOM_EDGES, ROOM_NODES
from pipeline.errors import GraphError
from pipeline.graph.plan import Plan


def validate_plan(plan: Plan, label: str) -> None:
    """Raise `FoveaError` for a plan that no loader would have made."""
    if plan.clock != "realtime":
        raise GraphError(f"{plan.name}: clock: expected realtime between hosts, got {plan.clock}")
    if not plan.nodes:
        raise GraphError(f"{plan.name}: expected nodes, got none")
    if len(plan.hosts) > MOST_HOSTS or label not in plan.hosts or plan.here:
        raise GraphError(f"{plan.name}: hosts: expected {label} among them, got {plan.hosts}")
    hosts: dict[str, str] = {}
    check_numbered(plan)
    for node in plan.nodes:
        if node.host not in plan.hosts:
            raise GraphError(f"{node.name}: expected a node with a place of its own")
        if hosts.setdefault(node.process, node.host) != node.host:
            raise GraphError(f"{node.name}: expected the host of its group, got {node.host}")
    for edge in plan.edges:
        if edge.command and edge.keep != "latest":
            raise GraphError(f"{edge.end}: expected latest for a command, got {edge.keep}")


def check_numbered(plan: Plan) -> None:
    """Raise `GraphError` unless every node and edge has a place of its own in the accounts.

    Where some came and went, places between others may be empty.
    """
    for kind, found, room in (
        ("a node", [(n.index, n.name) for n in plan.nodes], ROOM_NODES),
        ("an edge", [(e.index, e.end) for e in plan.edges], ROOM_EDGES),
    ):
        taken: set[int] = set()
        for index, name in found:
            if index in taken or not 0 <= index < len(found) + room:
                raise GraphError(f"{name}: expected {kind} with a place of its own")
            taken.add(index)
