"""Graph files: YAML to a checked plan. Every complaint says file, line, what, expected and got.

Everything is checked before a process starts: keys, operators, settings, ports, message types of
both ends, loops. Overlays change a graph without editing it: a source file replaces the settings of
the node that makes frames, `node.setting=value` changes one value.
"""

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from pipeline import settings as checked
from pipeline.bus.clocks import MOST_HOSTS
from pipeline.commands import commands_of
from pipeline.contract import Input, Operator, inputs_of, joined, live_of, outputs_of, settings_of
from pipeline.errors import GraphError, SettingsError
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Edge, Node, Plan, Restart, load_operator
from pipeline.graph.yaml_lines import YamlFile, plain

GRAPH_KEYS = ("name", "clock", "hosts", "nodes")
NODE_KEYS = ("operator", "inputs", "settings", "group", "host", "threads", "stall_s", "start_s",
             "memory_mb", "restart", "manual")  # fmt: skip
LABEL = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,30}")
EDGE_KEYS = ("from", "keep", "depth", "wait_ms", "max_age_ms", "stale", "transport")


def load(path: Path, overlay: Overlay | None = None) -> Plan:
    """Read, lay over, check; raises `GraphError` or `SettingsError` with file and line."""
    overlay = overlay or Overlay()
    file = YamlFile(path)
    document = file.document
    file.only(document, GRAPH_KEYS, "graph")
    nodes = file.mapping(document, "nodes", "graph")
    overlay.lay(file, nodes)
    clock = overlay.clock or document.get("clock", "realtime")
    if clock not in ("realtime", "lockstep"):
        file.fail(document, "clock", f"clock: expected realtime or lockstep, got {clock!r}")
    started = {
        name: nodes[name]
        for name in nodes
        if name in overlay.wanted or not file.mapping(nodes, name, "nodes").get("manual", False)
    }
    hosts = _hosts(file, document)
    return assemble(file, str(document.get("name", path.stem)), clock, started, hosts)


def assemble(
    file: YamlFile, name: str, clock: str, nodes: Mapping[str, Any], hosts: tuple[str, ...] = ()
) -> Plan:
    """The plan of these entries; raises `GraphError` or `SettingsError`."""
    parts = {part: _Part(file, nodes, part) for part in nodes}
    plan = Plan(
        name=name,
        clock="lockstep" if clock == "lockstep" else "realtime",
        nodes=tuple(part.node(i) for i, part in enumerate(parts.values())),
        edges=tuple(_edges(file, parts, clock)),
        hosts=hosts,
    )
    _check_places(file, parts, plan)
    _check_loops(plan, file.path)
    return plan


class _Part:
    """One node of the file, its operator imported and its settings checked."""

    def __init__(self, file: YamlFile, nodes: Any, name: str) -> None:
        self.file, self.name = file, name
        self.entry = file.mapping(nodes, name, "nodes")
        file.only(self.entry, NODE_KEYS, name)
        path = self.entry.get("operator")
        if not isinstance(path, str) or ":" not in path:
            file.fail(self.entry, "operator", f"{name}.operator: expected module:Class, got {path}")
        try:
            self.operator: type[Operator[Any, Any]] = load_operator(path)
        except GraphError as error:
            file.fail(self.entry, "operator", f"{name}.operator: {error}")
        self.inputs = inputs_of(self.operator)
        self.outputs = outputs_of(self.operator)
        self.settings = self._settings()
        self._check_handlers()

    def node(self, index: int) -> Node:
        """The plan's node."""
        entry = self.entry
        return Node(
            index=index,
            name=self.name,
            operator=entry["operator"],
            settings=self.settings,
            group=self._typed("group", str, ""),
            host=self._typed("host", str, ""),
            threads=self._typed("threads", int, 1),
            stall_s=self._positive("stall_s", 10.0),
            start_s=self._positive("start_s", 60.0),
            memory_mb=self._positive("memory_mb", 0.0),
            restart=self._restart(),
        )

    def _settings(self) -> dict[str, Any]:
        values = plain(self.entry.get("settings") or {})
        cls = settings_of(self.operator)
        if "threads" in self.entry and "threads" in {f.name for f in fields(cls)}:
            values.setdefault("threads", self.entry["threads"])
        where = f"{self.file.at(self.entry, 'settings')}: {self.name}"
        if not isinstance(values, dict):
            raise GraphError(f"{where}.settings: expected a mapping, got {values!r}")
        self._build(cls, values, where)
        live_of(self.operator)
        commands_of(self.operator)
        return values

    def _build(self, cls: type[Any], values: dict[str, Any], where: str) -> None:
        try:
            checked.build(cls, values, where)
        except SettingsError as error:
            settings = self.entry.get("settings")
            for key in values:  # point at the very line when the complaint names the setting
                if f"{self.name}.{key}:" in str(error) or f"{self.name}.{key}." in str(error):
                    place = self.file.at(settings, key)
                    raise SettingsError(f"{place}: {str(error).split(': ', 1)[1]}") from error
            raise

    def _restart(self) -> Restart:
        value = plain(self.entry.get("restart", {}))
        if isinstance(value, str):
            value = {"policy": value}
        where = f"{self.file.at(self.entry, 'restart')}: {self.name}.restart"
        if not isinstance(value, dict):
            raise GraphError(f"{where}: expected a policy or a mapping, got {value!r}")
        return checked.build(Restart, value, where)

    def _typed(self, key: str, kinds: Any, default: Any) -> Any:
        value = self.entry.get(key, default)
        if not isinstance(value, kinds) or isinstance(value, bool):
            self.file.fail(self.entry, key, f"{self.name}.{key}: got {value!r}")
        return value

    def _positive(self, key: str, default: float) -> float:
        value = float(self._typed(key, (int, float), default))
        if key in self.entry and not 0 < value < math.inf:
            self.file.fail(self.entry, key, f"{self.name}.{key}: must be positive, got {value:g}")
        return value

    def _check_handlers(self) -> None:
        groups: list[tuple[str, ...]] = [
            (n,) for n, i in self.inputs.items() if i.command or not i.join
        ]
        if together := joined(self.operator):
            groups.append(together)
        for names in groups:
            handler = "on_" + "_".join(names)
            if not callable(getattr(self.operator, handler, None)):
                self.file.fail(
                    self.entry,
                    "operator",
                    f"{self.name}: {self.operator.__name__} has no {handler}",
                )


def _hosts(file: YamlFile, document: Any) -> tuple[str, ...]:
    """The labels that nodes may name."""
    labels = plain(document.get("hosts") or [])
    if not isinstance(labels, list) or not all(
        isinstance(label, str) and LABEL.fullmatch(label) for label in labels
    ):
        file.fail(
            document, "hosts", f"hosts: expected labels of letters and digits, got {labels!r}"
        )
    if len(set(labels)) < len(labels) or len(labels) > MOST_HOSTS:
        file.fail(document, "hosts", f"hosts: expected up to {MOST_HOSTS} different labels")
    return tuple(labels)


def _check_places(file: YamlFile, parts: Mapping[str, _Part], plan: Plan) -> None:
    """Every node has a host that the graph knows, or none has one."""
    hosts_of: dict[str, str] = {}
    for node in plan.nodes:
        entry = parts[node.name].entry
        if node.host not in plan.hosts and (node.host or plan.hosts):
            got = f"no host {node.host}" if node.host else "expected a host, got none"
            hint = checked.suggest(node.host, plan.hosts) if plan.hosts else ""
            say = hint or "; the graph names its boxes with `hosts: [label, …]`"
            file.fail(entry, "host", f"{node.name}.host: {got}{say}")
        if hosts_of.setdefault(node.process, node.host) != node.host:
            file.fail(
                entry, "host", f"{node.name}.host: group {node.process} is on "
                f"{hosts_of[node.process]}, got {node.host}",
            )  # fmt: skip


def _edges(file: YamlFile, parts: Mapping[str, _Part], clock: str) -> Iterable[Edge]:
    index = 0
    for part in parts.values():
        given = part.entry.get("inputs") or {}
        if not isinstance(given, Mapping):
            file.fail(part.entry, "inputs", f"{part.name}.inputs: expected a mapping, got {given}")
        for name in given:
            if name not in part.inputs:
                hint = checked.suggest(str(name), part.inputs)
                file.fail(given, name, f"{part.name}.inputs.{name}: no such input{hint}")
        for name, port in part.inputs.items():
            if name not in given:
                if not (port.optional or port.command or not port.join):
                    file.fail(
                        part.entry, "inputs", f"{part.name}.inputs.{name}: required, got nothing"
                    )
                continue
            edge = _edge(file, parts, part, name, port, given)
            if edge is None:
                continue
            yield replace(edge, index=index, keep="every" if clock == "lockstep" else edge.keep)
            index += 1


def _edge(
    file: YamlFile, parts: Mapping[str, _Part], part: _Part, name: str, port: Input, given: Any
) -> Edge | None:
    where = f"{part.name}.inputs.{name}"
    long = given[name] if isinstance(given[name], Mapping) else {"from": given[name]}
    file.only(long, EDGE_KEYS, where)
    origin = long.get("from")
    if not isinstance(origin, str):
        file.fail(given, name, f"{where}: expected node or node.output, got {origin!r}")
    source, _, output = origin.partition(".")
    if source not in parts:
        hint = _suggest_origin(origin, parts)
        file.fail(given, name, f"{where}: no node {source}{hint}")
    writer = parts[source]
    output = output or "out"
    if output not in writer.outputs:
        options = [o if o != "out" else source for o in (f"{source}.{o}" for o in writer.outputs)]
        hint = checked.suggest(origin, options)
        file.fail(given, name, f"{where}: {source} has no output {output}{hint}")
    sent = writer.outputs[output]
    if sent is not port.message:
        file.fail(
            given, name, f"{where}: expected {port.message.__name__}, got {sent.__name__} "
            f"from {origin}",
        )  # fmt: skip
    values = _edge_values(file, given, name, where, long, port)
    return Edge(
        index=0, source=source, output=output, target=part.name, input=name, join=port.join,
        optional=port.optional, command=port.command, tap=port.tap, **values,
    )  # fmt: skip


def _edge_values(
    file: YamlFile, given: Any, name: str, where: str, long: Mapping[str, Any], port: Input
) -> dict[str, Any]:
    values: dict[str, Any] = {
        "keep": long.get("keep", port.keep),
        "depth": long.get("depth", port.depth),
        "wait_ms": float(long.get("wait_ms", port.wait_ms)),
        "max_age_ms": float(long.get("max_age_ms", port.max_age_ms)),
        "stale": long.get("stale", port.stale),
        "transport": long.get("transport", "pool"),
    }
    for key, allowed in (
        ("keep", ("latest", "every")), ("stale", ("drop", "pass")), ("transport", ("pool", "bytes"))
    ):  # fmt: skip
        if values[key] not in allowed:
            hint = difflib.get_close_matches(str(values[key]), allowed, 1)
            also = f", did you mean {hint[0]}?" if hint else ""
            file.fail(
                given, name, f"{where}.{key}: expected {' or '.join(allowed)}, got "
                f"{values[key]!r}{also}",
            )  # fmt: skip
    if not isinstance(values["depth"], int) or not 1 <= values["depth"] <= 64:
        file.fail(given, name, f"{where}.depth: expected 1 to 64, got {values['depth']!r}")
    if port.command and values["keep"] != "latest":
        file.fail(given, name, f"{where}.keep: a sensor command is always latest, got every")
    return values


def _suggest_origin(origin: str, parts: Mapping[str, _Part]) -> str:
    options = [
        name if output == "out" else f"{name}.{output}"
        for name, part in parts.items()
        for output in part.outputs
    ]
    return checked.suggest(origin, options)


def _check_loops(plan: Plan, path: Path) -> None:
    try:
        plan.order()
    except GraphError as error:
        raise GraphError(f"{path}: {error}") from error
