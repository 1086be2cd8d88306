"""What a running graph expects of an operator's ports: messages that come in and must go out."""

from typing import Any

from pipeline.contract import Operator, Source, inputs_of, outputs_of
from pipeline.errors import GraphError
from pipeline.graph.plan import Edge, Node, Plan, is_source, load_operator
from pipeline.protocol.supervision import PortContract
from pipeline.settings import suggest


def contract_of(plan: Plan, node: Node) -> PortContract:
    """What the edges of a node ask of its operator."""
    return PortContract(
        inputs={e.input: _sent(plan, e) for e in plan.inputs(node.name).values()},
        outputs={e.output: _sent(plan, e) for e in plan.edges if e.source == node.name},
        source=is_source(node),
    )


def check_fit(plan: Plan, node: Node, contract: PortContract) -> None:
    """Raise `GraphError` when the operator of a node does not fulfil the contract."""
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
        if (sends := _path(declared[name])) != message:
            raise GraphError(f"{where}: expected {_short(message)}, {node.operator} sends "
                             f"{_short(sends)}")  # fmt: skip


def _check_inputs(
    plan: Plan, node: Node, operator: type[Operator[Any, Any]], contract: PortContract
) -> None:
    edges, declared = plan.inputs(node.name), inputs_of(operator)
    for name, message in contract.inputs.items():
        where = f"{node.name}.inputs.{name}"
        if name not in declared:
            raise GraphError(f"{where}: {node.operator} has no such input{suggest(name, declared)}")
        port, edge = declared[name], edges[name]
        if (wants := _path(port.message)) != message:
            raise GraphError(
                f"{where}: expected {_short(wants)}, got {_short(message)} from {edge.origin}"
            )
        if (port.join, port.command) != (edge.join, edge.command):
            raise GraphError(f"{where}: {node.operator} joins it otherwise than the running part")
    for name, port in declared.items():
        if name not in contract.inputs and port.join and not (port.optional or port.command):
            raise GraphError(f"{node.name}.inputs.{name}: required, got nothing")


def _sent(plan: Plan, edge: Edge) -> str:
    if not plan.is_here(
        plan.node(edge.source)
    ):  # its code is none of ours; its fingerprints agreed
        reader = load_operator(plan.node(edge.target).operator)
        return _path(inputs_of(reader)[edge.input].message)
    return _path(outputs_of(load_operator(plan.node(edge.source).operator))[edge.output])


def _path(message: type[Any]) -> str:
    return f"{message.__module__}:{message.__qualname__}"


def _short(path: str) -> str:
    return path.partition(":")[2]
