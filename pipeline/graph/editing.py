"""Edit a running graph's plan: add, remove or rewire nodes.

Only the operators of added nodes are loaded. `ports_of` asks the running graph for the ports of the
others; without it their operators are loaded, too. Mismatches are refused as by the loader, with
file and line.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline import codec
from pipeline.contract import inputs_of, outputs_of
from pipeline.errors import GraphError
from pipeline.graph.loader import Sent, extended
from pipeline.graph.plan import Edge, Plan, load_operator, no_output
from pipeline.graph.yaml_lines import YamlFile
from pipeline.settings import suggest


@dataclass(frozen=True)
class PortTypes:
    """The message types of a node's inputs and outputs, by name."""

    inputs: Mapping[str, Sent]
    outputs: Mapping[str, Sent]


PortTypesOf = Callable[[str], PortTypes]  # the ports of a running node, by its name


def with_nodes(plan: Plan, path: Path, ports_of: PortTypesOf | None = None) -> Plan:
    """Return the plan with the nodes of a file; raises `GraphError` or `SettingsError`."""
    file = YamlFile(path)
    file.only(file.document, ("nodes",), "addition")
    fresh = file.mapping(file.document, "nodes", "addition")
    for name in fresh:
        if name in {n.name for n in plan.nodes}:
            file.fail(fresh, name, f"nodes.{name}: there is a node of that name already")
    known = ports_of or loaded_ports(plan)
    return extended(file, plan, fresh, lambda node: known(node).outputs)


def without_node(plan: Plan, name: str) -> Plan:
    """Return the plan without a node; raises `GraphError` if the node has readers."""
    _check_known(plan, name)
    for edge in plan.edges:
        if edge.source == name != edge.target:
            raise GraphError(f"{name}: {edge.end} reads it: expected to rewire that first")
    if len(plan.nodes) == 1:
        raise GraphError(f"{name}: {plan.name} has no other node; `fovea stop` ends it")
    return replace(
        plan,
        nodes=tuple(n for n in plan.nodes if n.name != name),
        edges=tuple(e for e in plan.edges if e.target != name),
    )


def rewired(plan: Plan, wire: str, ports_of: PortTypesOf | None = None) -> Plan:
    """Return the plan with an input connected elsewhere: `node.input=source.output`."""
    end, equals, origin = wire.partition("=")
    node, dot, name = end.partition(".")
    if not (equals and dot and node and name and origin):
        raise GraphError(f"{wire}: expected node.input=source or node.input=source.output")
    _check_known(plan, node)
    inputs = plan.inputs(node)
    if name not in inputs:
        raise GraphError(f"{end}: no such edge{suggest(name, inputs)}")
    source, _, output = origin.partition(".")
    changed = replace(inputs[name], source=source, output=output or "out")
    known = ports_of or loaded_ports(plan)
    _check_origin(plan, changed, known)
    edges = tuple(changed if e.end == changed.end else e for e in plan.edges)
    wanted = replace(plan, edges=edges)
    try:
        wanted.order()
    except GraphError as error:
        raise GraphError(f"{plan.name}: {wire}: {error}") from error
    return wanted


def loaded_ports(plan: Plan) -> PortTypesOf:
    """Return a function for the ports of a plan's nodes, which loads their operators."""

    def ports_of(name: str) -> PortTypes:
        operator = load_operator(plan.node(name).operator)
        return PortTypes(
            {n: _sent(port.message) for n, port in inputs_of(operator).items()},
            {n: _sent(message) for n, message in outputs_of(operator).items()},
        )

    return ports_of


def _sent(message: type) -> Sent:
    return Sent(message.__name__, codec.fingerprint(message).hex())


def _check_origin(plan: Plan, edge: Edge, ports_of: PortTypesOf) -> None:
    where = f"{plan.name}: {edge.target}.inputs.{edge.input}"
    names = [n.name for n in plan.nodes]
    if edge.source not in names:
        raise GraphError(f"{where}: no node {edge.source}{suggest(edge.source, names)}")
    outputs = ports_of(edge.source).outputs
    if edge.output not in outputs:
        raise GraphError(f"{where}: {no_output(edge.origin, outputs)}")
    wanted, sent = ports_of(edge.target).inputs[edge.input], outputs[edge.output]
    if wanted != sent:
        raise GraphError(f"{where}: {wanted.against(sent)} from {edge.origin}")


def _check_known(plan: Plan, name: str) -> None:
    names = [n.name for n in plan.nodes]
    if name not in names:
        raise GraphError(f"{plan.name}: no node {name}{suggest(name, names)}")
