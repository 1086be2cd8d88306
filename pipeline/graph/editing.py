"""A running graph's plan in the words of a graph file, with nodes added, removed or rewired.

The loader checks the whole as if it had been written so, and says what is wrong with file and line.
"""

from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from pipeline.errors import GraphError
from pipeline.graph.loader import assemble
from pipeline.graph.plan import Edge, Node, Plan
from pipeline.graph.spec import EDGE_KEYS, NODE_KEYS
from pipeline.graph.yaml_lines import YamlFile
from pipeline.graph.yaml_reader import YamlMapping
from pipeline.settings import suggest


def with_nodes(plan: Plan, path: Path) -> Plan:
    """The plan and the nodes of a file; raises `GraphError` or `SettingsError`."""
    file = YamlFile(path)
    file.only(file.document, ("nodes",), "addition")
    fresh = file.mapping(file.document, "nodes", "addition")
    for name in fresh:
        if name in {n.name for n in plan.nodes}:
            file.fail(fresh, name, f"nodes.{name}: there is a node of that name already")
    return assemble(file, plan.name, plan.clock, {**entries(plan), **fresh}, plan.hosts)


def without_node(plan: Plan, name: str) -> Plan:
    """The plan without a node that nobody reads."""
    _known(plan, name)
    for edge in plan.edges:
        if edge.source == name != edge.target:
            raise GraphError(f"{name}: {edge.end} reads it: expected to rewire that first")
    left = {n: e for n, e in entries(plan).items() if n != name}
    return assemble(_Words(plan), plan.name, plan.clock, left, plan.hosts)


def rewired(plan: Plan, wire: str) -> Plan:
    """The plan with an input connected elsewhere: `node.input=source.output`."""
    end, equals, origin = wire.partition("=")
    node, dot, name = end.partition(".")
    if not (equals and dot and node and name and origin):
        raise GraphError(f"{wire}: expected node.input=source or node.input=source.output")
    _known(plan, node)
    changed = entries(plan)
    inputs = changed[node]["inputs"]
    if name not in inputs:
        raise GraphError(f"{end}: no such edge{suggest(name, inputs)}")
    inputs[name] = {**inputs[name], "from": origin}
    return assemble(_Words(plan), plan.name, plan.clock, changed, plan.hosts)


def entries(plan: Plan) -> dict[str, dict[str, Any]]:
    """The nodes as a graph file has them."""
    return {node.name: _entry(plan, node) for node in plan.nodes}


def _entry(plan: Plan, node: Node) -> dict[str, Any]:
    values, usual = asdict(node), {f.name: f.default for f in fields(Node)}
    entry = {k: values[k] for k in NODE_KEYS if k in values and values[k] != usual[k]}
    inputs = {name: _wire(edge) for name, edge in plan.inputs(node.name).items()}
    return {**entry, "inputs": inputs}


def _wire(edge: Edge) -> Mapping[str, Any]:
    return {"from": edge.origin, **{k: v for k, v in asdict(edge).items() if k in EDGE_KEYS}}


def _known(plan: Plan, name: str) -> None:
    names = [n.name for n in plan.nodes]
    if name not in names:
        raise GraphError(f"{plan.name}: no node {name}{suggest(name, names)}")


class _Words(YamlFile):
    """Stands for the file in errors about a graph that runs."""

    def __init__(self, plan: Plan) -> None:
        self.path, self.document = Path(plan.name), YamlMapping(plan.name)
