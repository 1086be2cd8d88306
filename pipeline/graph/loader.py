"""Load graph files: YAML to a checked plan. Every error has file, line, expected and got.

Everything is checked before a process starts: first the file alone (`pipeline.graph.spec`), then
operators, settings, ports, message types of both ends, loops. Overlays change a graph without
editing it: a source file replaces the settings of the source node, `node.setting=value` changes one
value.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from pipeline import codec
from pipeline import settings as checked
from pipeline.contract import Input, Operator, handlers_of, inputs_of, outputs_of, settings_of
from pipeline.errors import GraphError, SettingsError
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Clock, Edge, Node, Plan, load_operator, no_output
from pipeline.graph.spec import EdgeSpec, NodeSpec, check_places, graph_spec, node_specs
from pipeline.graph.yaml_lines import YamlFile
from pipeline.messages import Message
from pipeline.wording import shown_key


class Sent(NamedTuple):
    """The type of a message, without its class."""

    message: str
    fingerprint: str  # of its schema

    def against(self, sent: "Sent") -> str:
        """Return a mismatch as text: expected …, got …."""
        same = self.message == sent.message
        return f"expected {self.message}, got {'another ' if same else ''}{sent.message}"


FROM_PORT = ("keep", "depth", "wait_ms", "max_age_ms", "stale")  # defaults are the port's


def load(path: Path, overlay: Overlay | None = None) -> Plan:
    """Read, overlay and check; raises `GraphError` or `SettingsError` with file and line."""
    overlay = overlay or Overlay()
    file = YamlFile(path)
    spec = graph_spec(file, overlay.clock)
    if overlay.lay(file, spec):
        spec = graph_spec(file, overlay.clock)
    started = {n: s for n, s in spec.nodes.items() if n in overlay.wanted or not s.manual}
    if not started:
        file.fail(file.document, "nodes", "nodes: expected one that starts, got manual ones only")
    return _plan(file, spec.name, spec.clock, started, spec.hosts)


def extended(
    file: YamlFile, plan: Plan, nodes: Mapping[str, Any],
    outputs_of_running: Callable[[str], Mapping[str, Sent]],
) -> Plan:  # fmt: skip
    """Return the plan of a running graph extended by nodes of a file; raises `FoveaError`.

    The operators of running nodes are not loaded: the graph is asked for their outputs.
    """
    specs = node_specs(file, nodes)
    check_places(file, specs, plan.hosts)
    fresh = {name: _LoadedNode(file, spec) for name, spec in specs.items()}
    running = {n.name: _RunningNode(n.name, outputs_of_running) for n in plan.nodes}
    first_node = 1 + max((n.index for n in plan.nodes), default=-1)
    first_edge = 1 + max((e.index for e in plan.edges), default=-1)
    try:
        edges = [
            replace(edge, index=first_edge + i)
            for i, edge in enumerate(_edges(file, fresh, plan.clock, {**running, **fresh}))
        ]
        wanted = replace(
            plan,
            nodes=(*plan.nodes, *(n.node(first_node + i) for i, n in enumerate(fresh.values()))),
            edges=(*plan.edges, *edges),
        )
        wanted.order()
    except _LocatedError as error:
        raise GraphError(str(error)) from error.__cause__
    except GraphError as error:
        raise GraphError(f"{file.at(file.document, 'nodes')}: {error}") from error
    return wanted


def _plan(
    file: YamlFile, name: str, clock: Clock, specs: Mapping[str, NodeSpec], hosts: tuple[str, ...]
) -> Plan:
    check_places(file, specs, hosts)
    nodes = {node: _LoadedNode(file, spec) for node, spec in specs.items()}
    place = file.at(file.document, "nodes")
    try:
        plan = Plan(
            name=name,
            clock=clock,
            nodes=tuple(loaded.node(i) for i, loaded in enumerate(nodes.values())),
            edges=tuple(_edges(file, nodes, clock, nodes)),
            hosts=hosts,
        )
        plan.order()
    except _LocatedError as error:
        raise GraphError(str(error)) from error.__cause__
    except GraphError as error:
        raise GraphError(f"{place}: {error}") from error
    return plan


class _LocatedError(GraphError):
    """An error whose text already begins with file and line."""


class _RunningNode:
    """A running node at which an edge may begin."""

    def __init__(self, name: str, outputs_of_running: Callable[[str], Mapping[str, Sent]]) -> None:
        self._name, self._ask = name, outputs_of_running

    @property
    def outputs(self) -> Mapping[str, Sent]:
        """Return its message types by output; raises `FoveaError` when it does not answer."""
        return self._ask(self._name)


class _LoadedNode:
    """One node of the file, its operator imported and its settings checked."""

    def __init__(self, file: YamlFile, spec: NodeSpec) -> None:
        self.file, self.spec, self.name = file, spec, spec.name
        where = f"{file.at(spec.entry, 'operator')}: {spec.name}.operator"
        self.operator: type[Operator[Any, Any]] = load_operator(spec.operator, where)
        self.inputs = inputs_of(self.operator)
        self.outputs = outputs_of(self.operator)
        self.settings = self._settings()
        self._check_handlers()

    def node(self, index: int) -> Node:
        """Return the node for the plan."""
        return Node(
            index=index,
            name=self.name,
            operator=self.spec.operator,
            settings=self.settings,
            restart=self.spec.restart,
            **self.spec.given,
        )

    def _settings(self) -> dict[str, Any]:
        values, cls = dict(self.spec.settings), settings_of(self.operator)
        if "threads" in self.spec.given and "threads" in {f.name for f in fields(cls)}:
            values.setdefault("threads", self.spec.given["threads"])
        try:
            checked.build(cls, values, self.name)
        except checked.WrongSetting as error:
            written = self.spec.entry.get("settings")
            place = self.file.at(self.spec.entry, "settings")
            if error.path and error.path[0] in (written or {}):
                place = self.file.deepest(written, error.path)
            raise SettingsError(f"{place}: {error}") from error
        except (SettingsError, GraphError) as error:
            place = self.file.at(self.spec.entry, "settings")
            raise SettingsError(f"{place}: {error}") from error
        return values

    def _check_handlers(self) -> None:
        for handler in handlers_of(self.operator):
            if not callable(getattr(self.operator, handler, None)):
                what = f"{self.name}: {self.operator.__name__} has no {handler}"
                self.file.fail(self.spec.entry, "operator", what)


_Origins = Mapping[str, "_LoadedNode | _RunningNode"]


def _edges(
    file: YamlFile, nodes: Mapping[str, _LoadedNode], clock: Clock, origins: _Origins
) -> Iterator[Edge]:
    index = 0
    for loaded in nodes.values():
        for name, spec in loaded.spec.inputs.items():
            if name not in loaded.inputs:
                hint = checked.suggest(name, loaded.inputs)
                raise _LocatedError(f"{spec.place}: {spec.where}: no such input{hint}")
        for name, port in loaded.inputs.items():
            if name in loaded.spec.inputs:
                spec = loaded.spec.inputs[name]
                yield _edge(origins, loaded.name, name, port, spec, clock, index)
                index += 1
            elif port.join and not (port.optional or port.command):
                place = file.at(loaded.spec.entry, "inputs")
                raise _LocatedError(f"{place}: {loaded.name}.inputs.{name}: required, got nothing")


def _edge(
    nodes: _Origins, target: str, name: str, port: Input, spec: EdgeSpec, clock: Clock, index: int
) -> Edge:  # fmt: skip
    place = f"{spec.place}: {spec.where}"
    if spec.source not in nodes:
        hint = _suggest_origin(spec.origin, nodes)
        raise _LocatedError(f"{place}: no node {shown_key(spec.source)}{hint}")
    outputs = nodes[spec.source].outputs
    if spec.output not in outputs:
        raise _LocatedError(f"{place}: {no_output(spec.origin, outputs)}")
    if differs := _difference(port.message, outputs[spec.output]):
        raise _LocatedError(f"{place}: {differs} from {spec.origin}")
    values = {key: getattr(port, key) for key in FROM_PORT} | {"transport": "pool"}
    values |= spec.given
    if port.command and values["keep"] != "latest":
        raise _LocatedError(f"{place}.keep: a sensor command is always latest, got every")
    if clock == "lockstep":
        values["keep"] = "every"
    return Edge(
        index=index, source=spec.source, output=spec.output, target=target, input=name,
        join=port.join, optional=port.optional, command=port.command, tap=port.tap, **values,
    )  # fmt: skip


def _difference(wanted: type[Message], sent: type[Message] | Sent) -> str:
    """Return a type mismatch of an input as text; empty where the types agree."""
    if isinstance(sent, Sent):
        ours = Sent(wanted.__name__, codec.fingerprint(wanted).hex())
        return "" if ours == sent else ours.against(sent)
    return "" if sent is wanted else f"expected {wanted.__name__}, got {sent.__name__}"


def _suggest_origin(origin: str, nodes: _Origins) -> str:
    options = [_origin(name, output) for name, loaded in nodes.items() for output in loaded.outputs]
    return checked.suggest(origin, options)


def _origin(node: str, output: str) -> str:
    return node if output == "out" else f"{node}.{output}"
