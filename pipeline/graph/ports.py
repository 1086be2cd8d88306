"""Ports of operators, and their check against the edges of a plan.

The loader makes valid plans; a plan from another origin is checked before anything starts. A
supervisor imports nothing for that: the processes that import operators report their ports.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pipeline import codec
from pipeline import settings as checked
from pipeline.contract import Source, inputs_of, outputs_of, settings_of
from pipeline.errors import GraphError, SettingsError
from pipeline.graph.plan import Edge, Node, Plan, load_operator
from pipeline.settings import suggest

DECLARED = ("join", "optional", "command", "tap")


@dataclass(frozen=True, kw_only=True)
class InputPort:
    """An input as the operator declares it."""

    message: str  # module:Class
    join: bool
    optional: bool
    command: bool
    tap: bool


@dataclass(frozen=True, kw_only=True)
class Ports:
    """An operator's inputs, and the messages (`module:Class`) of its outputs, by name."""

    inputs: Mapping[str, InputPort]
    outputs: Mapping[str, str]
    source: bool  # whether it is a source


PortsOf = Callable[[Node], Ports]


def declared_ports(operator: str) -> Ports:
    """Import `module:Class` and return its ports; raises `GraphError`."""
    cls = load_operator(operator)
    inputs = {
        name: InputPort(
            message=message_path(port.message),
            **{declared: getattr(port, declared) for declared in DECLARED},
        )
        for name, port in inputs_of(cls).items()
    }
    outputs = {name: message_path(message) for name, message in outputs_of(cls).items()}
    return Ports(inputs=inputs, outputs=outputs, source=issubclass(cls, Source))


def check_ports(
    plan: Plan,
    is_here: Callable[[Node], bool],
    ports_of: PortsOf = lambda node: declared_ports(node.operator),
) -> None:
    """Raise `FoveaError` for an edge that does not fit the operators on this host.

    Without `ports_of` the operators are imported.
    """
    for edge in plan.edges:
        _check_edge(plan, edge, is_here, ports_of)
    for node in filter(is_here, plan.nodes):
        given = plan.inputs(node.name)
        for name, port in ports_of(node).inputs.items():
            if name not in given and port.join and not (port.optional or port.command):
                raise GraphError(f"{node.name}.inputs.{name}: required, got nothing")


def check_operators(plan: Plan) -> None:
    """Import the operators of this host; raise `FoveaError` unless they and their settings fit."""
    for node in filter(plan.is_here, plan.nodes):
        checked.build(settings_of(load_operator(node.operator)), node.settings, node.name)
    check_ports(plan, plan.is_here)


def fingerprints(plan: Plan) -> dict[str, str]:
    """Import the operators here; return fingerprints of messages sent and expected.

    The keys are `node.output`.
    """
    found: dict[str, str] = {}
    for edge in plan.edges:
        source, target = plan.node(edge.source), plan.node(edge.target)
        if plan.is_here(source):
            message = outputs_of(load_operator(source.operator))[edge.output]
            found[edge.origin] = codec.fingerprint(message).hex()
        if plan.is_here(target):
            message = inputs_of(load_operator(target.operator))[edge.input].message
            found[edge.origin] = codec.fingerprint(message).hex()
    return found


def check_fingerprints(plan: Plan, theirs: Mapping[str, str]) -> None:
    """Raise `GraphError` where a message of this host differs from the expected schema."""
    for origin, mine in fingerprints(plan).items():
        if theirs.get(origin) != mine:
            raise GraphError(
                f"{origin}: expected messages of schema {theirs.get(origin, 'none')}, got {mine} "
                "here; install the same version on all hosts"
            )


def message_path(message: type) -> str:
    """Return `module:Class` of a message."""
    return f"{message.__module__}:{message.__qualname__}"


def short(path: str) -> str:
    """Return the class name in `module:Class`."""
    return path.partition(":")[2]


def _check_edge(plan: Plan, edge: Edge, is_here: Callable[[Node], bool], ports_of: PortsOf) -> None:
    source, target = plan.node(edge.source), plan.node(edge.target)
    if is_here(source):
        outputs = ports_of(source).outputs
        if edge.output not in outputs:
            hint = suggest(edge.output, outputs)
            raise GraphError(f"{edge.source}: no output {edge.output}{hint}")
    if is_here(target):
        inputs = ports_of(target).inputs
        if edge.input not in inputs:
            raise GraphError(f"{edge.target}: no input {edge.input}{suggest(edge.input, inputs)}")
        port = inputs[edge.input]
        if any(getattr(port, name) != getattr(edge, name) for name in DECLARED):
            raise SettingsError(f"{edge.end}: expected the input as it is declared")
    if is_here(source) and is_here(target) and outputs[edge.output] != port.message:
        raise GraphError(
            f"{edge.end}: expected {short(port.message)}, got {short(outputs[edge.output])} "
            f"from {edge.origin}"
        )
