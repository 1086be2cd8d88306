"""Whether the operators of a plan have the ports that its edges name, with what the edges say.

The loader makes plans that pass; one that came from elsewhere is looked at before anything starts.
"""

from collections.abc import Callable

from pipeline.contract import inputs_of, outputs_of
from pipeline.errors import GraphError, SettingsError
from pipeline.graph.plan import Edge, Node, Plan, load_operator
from pipeline.settings import suggest

DECLARED = ("join", "optional", "command", "tap")


def check_ports(plan: Plan, is_here: Callable[[Node], bool]) -> None:
    """Raise `FoveaError` for an edge that does not fit the operators here; no others are loaded."""
    for edge in plan.edges:
        _check_edge(plan, edge, is_here)
    for node in filter(is_here, plan.nodes):
        given = plan.inputs(node.name)
        for name, port in inputs_of(load_operator(node.operator)).items():
            if name not in given and port.join and not (port.optional or port.command):
                raise GraphError(f"{node.name}.inputs.{name}: required, got nothing")


def _check_edge(plan: Plan, edge: Edge, is_here: Callable[[Node], bool]) -> None:
    source, target = plan.node(edge.source), plan.node(edge.target)
    if is_here(source):
        outputs = outputs_of(load_operator(source.operator))
        if edge.output not in outputs:
            hint = suggest(edge.output, outputs)
            raise GraphError(f"{edge.source}: no output {edge.output}{hint}")
    if is_here(target):
        inputs = inputs_of(load_operator(target.operator))
        if edge.input not in inputs:
            raise GraphError(f"{edge.target}: no input {edge.input}{suggest(edge.input, inputs)}")
        port = inputs[edge.input]
        if any(getattr(port, name) != getattr(edge, name) for name in DECLARED):
            raise SettingsError(f"{edge.end}: expected the input as it is declared")
    if is_here(source) and is_here(target) and outputs[edge.output] is not port.message:
        raise GraphError(
            f"{edge.end}: expected {port.message.__name__}, got {outputs[edge.output].__name__} "
            f"from {edge.origin}"
        )
