"""Contract between a running graph and an operator's ports: message types in and out."""

from typing import Any

from pipeline.contract import Operator, Source, inputs_of, outputs_of
from pipeline.errors import GraphError
from pipeline.graph.plan import Edge, Node, Plan, load_operator
from pipeline.graph.ports import PortsOf, message_path, short
from pipeline.protocol.supervision import PortContract
from pipeline.settings import suggest


def contract_of(plan: Plan, node: Node, ports_of: PortsOf) -> PortContract:
    """Return the contract of a node's edges, from the ports of the running nodes."""
    return PortContract(
        inputs={e.input: _sent(plan, e, ports_of) for e in plan.inputs(node.name).values()},
        outputs={e.output: _sent(plan, e, ports_of) for e in plan.edges if e.source == node.name},
        source=ports_of(node).source,
    )


def check_fit(plan: Plan, node: Node, contract: PortContract) -> None:
    """Raise `GraphError` when a node's operator does not fulfil the contract."""
    operator = load_operator(node.operator)
    if issubclass(operator, Source) != contract.source:
        expected, got = "makes", "does not"
        if not contract.source:
            expected, got = "answers", "makes them"
        raise GraphError(
            f"{node.name}: expected an operator that {expected} frames, {node.operator} {got}"
        )
    _check_inputs(plan, node, operator, contract)
    declared = outputs_of(operator)
    for name, message in contract.outputs.items():
        where = node.name if name == "out" else f"{node.name}.{name}"
        if name not in declared:
            raise GraphError(
                f"{where}: {node.operator} has no such output{suggest(name, declared)}"
            )
        if (sends := message_path(declared[name])) != message:
            raise GraphError(f"{where}: expected {short(message)}, {node.operator} sends "
                             f"{short(sends)}")  # fmt: skip


def _check_inputs(
    plan: Plan, node: Node, operator: type[Operator[Any, Any]], contract: PortContract
) -> None:
    edges, declared = plan.inputs(node.name), inputs_of(operator)
    for name, message in contract.inputs.items():
        where = f"{node.name}.inputs.{name}"
        if name not in declared:
            raise GraphError(f"{where}: {node.operator} has no such input{suggest(name, declared)}")
        port, edge = declared[name], edges[name]
        if (wants := message_path(port.message)) != message:
            raise GraphError(
                f"{where}: expected {short(wants)}, got {short(message)} from {edge.origin}"
            )
        if (port.join, port.command) != (edge.join, edge.command):
            raise GraphError(f"{where}: {node.operator} joins it unlike the running operator")
    for name, port in declared.items():
        if name not in contract.inputs and port.join and not (port.optional or port.command):
            raise GraphError(f"{node.name}.inputs.{name}: required, got nothing")


def _sent(plan: Plan, edge: Edge, ports_of: PortsOf) -> str:
    source = plan.node(edge.source)
    if not plan.is_here(source):  # its code is on another host; fingerprints were compared
        return ports_of(plan.node(edge.target)).inputs[edge.input].message
    return ports_of(source).outputs[edge.output]
