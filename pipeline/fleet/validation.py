"""Validation of a plan that came over the wire, beyond what holds for every plan.

Names, numbers and the ends of edges are checked with the plan. Nothing of it is loaded for this.
"""

from pipeline.bus.clocks import MOST_HOSTS
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
    for index, node in enumerate(plan.nodes):
        if node.index != index or node.host not in plan.hosts:
            raise GraphError(f"{node.name}: expected a node with a place of its own")
        if hosts.setdefault(node.process, node.host) != node.host:
            raise GraphError(f"{node.name}: expected the host of its group, got {node.host}")
    for index, edge in enumerate(plan.edges):
        if edge.index != index:
            raise GraphError(f"{edge.end}: expected an edge with a place of its own")
        if edge.command and edge.keep != "latest":
            raise GraphError(f"{edge.end}: expected latest for a command, got {edge.keep}")
