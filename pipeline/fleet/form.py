"""A plan that came over the wire, looked at from the ground up: names, numbers, how it is tied.

Nothing of it is loaded for that.
"""

import re
from collections.abc import Mapping
from typing import Any

from pipeline.bus.clocks import MOST_HOSTS
from pipeline.errors import GraphError
from pipeline.fleet.names import check_label, check_name
from pipeline.graph.plan import Edge, Node, Plan

MOST_NODES, MOST_EDGES = 128, 512
DAY_S = 86400.0
Limits = Mapping[str, tuple[float, float]]
NODE: Limits = {
    "threads": (1, 64), "stall_s": (0.1, DAY_S), "start_s": (0.1, DAY_S), "memory_mb": (0, 1e7),
}  # fmt: skip
RESTART: Limits = {"backoff_s": (0.001, DAY_S), "window_s": (0.1, DAY_S), "most": (0, 10_000)}
EDGE: Limits = {"depth": (1, 64), "wait_ms": (0, 1000 * DAY_S), "max_age_ms": (0, 1000 * DAY_S)}
_PORT = re.compile(r"[A-Za-z_]\w{0,62}")


def check_form(plan: Plan, label: str) -> None:
    """Raise `FoveaError` for a plan that no loader would have made."""
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
    _check_nodes(plan)
    _check_edges(plan)


def _check_nodes(plan: Plan) -> None:
    names = set()
    hosts: dict[str, str] = {}
    for index, node in enumerate(plan.nodes):
        check_name(node.name, "nodes")
        check_name(node.process, f"{node.name}.group")
        if node.index != index or node.name in names or node.host not in plan.hosts:
            raise GraphError(f"{node.name}: expected a node with a place of its own")
        if hosts.setdefault(node.process, node.host) != node.host:
            raise GraphError(f"{node.name}: expected the host of its group, got {node.host}")
        _check_numbers(node, NODE, node.name)
        _check_numbers(node.restart, RESTART, f"{node.name}.restart")
        names.add(node.name)


def _check_edges(plan: Plan) -> None:
    names, ends = {node.name for node in plan.nodes}, set()
    for index, edge in enumerate(plan.edges):
        if edge.index != index or not {edge.source, edge.target} <= names or edge.end in ends:
            raise GraphError(f"{edge.end}: expected one edge between two nodes")
        if not _PORT.fullmatch(edge.input) or not _PORT.fullmatch(edge.output):
            raise GraphError(f"{edge.end}: expected names of ports")
        _check_numbers(edge, EDGE, edge.end)
        if edge.command and edge.keep != "latest":
            raise GraphError(f"{edge.end}: expected latest for a command, got {edge.keep}")
        ends.add(edge.end)


def _check_numbers(of: Node | Edge | Any, limits: Limits, where: str) -> None:
    for name, (low, high) in limits.items():
        if not low <= (value := getattr(of, name)) <= high:  # nor for what is no number
            raise GraphError(f"{where}.{name}: expected {low:g} to {high:g}, got {value!r}")
