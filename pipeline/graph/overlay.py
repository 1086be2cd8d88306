"""Overlays from the command line on a graph file: another source, single values, manual nodes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from pipeline.contract import Source, settings_of
from pipeline.errors import GraphError
from pipeline.graph.plan import load_operator
from pipeline.graph.spec import GraphSpec, NodeSpec, graph_spec
from pipeline.graph.yaml_lines import YamlFile, kind_of, plain
from pipeline.graph.yaml_reader import YamlMapping, read_text
from pipeline.naming import LONGEST_NAME
from pipeline.settings import suggest
from pipeline.wording import shown, shown_key

SOURCE_KEYS = ("operator", "settings", "nodes", "instead")
LONGEST_TARGET, LONGEST_VALUE = 2 * LONGEST_NAME + 40, 40  # characters of an argument in an error


@dataclass(frozen=True)
class Overlay:
    """An overlay from the command line on a graph file."""

    source: Path | None = None  # a YAML file with `settings` and perhaps other `SOURCE_KEYS`
    changes: tuple[str, ...] = ()  # node.setting=value
    clock: str = ""
    wanted: tuple[str, ...] = ()  # manual nodes to start
    values: tuple[tuple[str, str, Any], ...] = ()  # node, setting and parsed value

    def lay(self, file: YamlFile, spec: GraphSpec) -> bool:
        """Change the parsed file in place; raises `GraphError` for unknown nodes or settings.

        Returns whether anything changed and the file must be checked again.
        """
        nodes = file.document["nodes"]
        if self.source:
            _lay_source(file, nodes, spec, self.source)
        for change in self.changes:
            try:
                node, setting, value = read_change(change)
            except GraphError as error:
                raise GraphError(f"--set {error}") from error
            _lay_value(file, nodes, f"--set {shown_change(change)}", node, setting, value)
        for node, setting, value in self.values:
            _lay_value(file, nodes, "settings", node, setting, value)
        for name in self.wanted:
            if name not in nodes:
                raise GraphError(f"{file.path}: no node {shown_key(name)}{suggest(name, nodes)}")
        return bool(self.source or self.changes or self.values)


def manual_nodes(path: Path, setting: str) -> list[str]:
    """Return the nodes that start only on request and have that setting."""
    file = YamlFile(path)
    nodes = graph_spec(file).nodes.values()
    return [n.name for n in nodes if n.manual and setting in _settings_of(file, n.entry, n.name)]


def source_document(path: Path) -> YamlFile:
    """Read a source file and check its keys; raises `GraphError` with file and line."""
    over = YamlFile(path)
    over.only(over.document, SOURCE_KEYS, "source")
    for key in ("settings", "nodes", "instead"):
        if key in over.document:
            over.mapping(over.document, key, "source")
    for origin, target in over.document.get("instead", {}).items():
        if not isinstance(target, str):
            what = f"source.instead.{shown_key(origin)}: expected a node or node.output, got "
            over.fail(over.document["instead"], origin, what + kind_of(target))
    return over


def read_settings(path: Path) -> Iterator[tuple[str, str, Any]]:
    """Yield node, setting and value of a file of settings by node; raises `GraphError`."""
    file = YamlFile(path)
    for node in file.document:
        for setting, value in file.mapping(file.document, node, "settings").items():
            yield str(node), str(setting), plain(value)


def read_change(change: str) -> tuple[str, str, Any]:
    """Parse `node.setting=value`; raises `GraphError` for any other form.

    >>> read_change("policy.prompt_box=[1, 2, 3, 4]")
    ('policy', 'prompt_box', [1, 2, 3, 4])
    """
    target, equals, text = change.partition("=")
    node, dot, setting = target.partition(".")
    if not (equals and dot and node and setting):
        raise GraphError(f"{shown_change(change)}: expected node.setting=value")
    return node, setting, read_value(text, target)


def read_value(text: str, name: str) -> Any:
    """Parse a value as a YAML file would; raises `GraphError` beginning with name and value.

    >>> read_value("[1, 2]", "a.b"), read_value("off", "a.b"), read_value("", "a.b")
    ([1, 2], 'off', '')
    """
    if not text:
        return ""
    return read_text(text, f"{shown_change(f'{name}={text}')}: not a value")


def shown_change(change: str) -> str:
    """Return an argument for an error message, with long parts truncated.

    >>> shown_change("ticker.rate_hz=" + 400 * "9")
    'ticker.rate_hz=9999999999999999999999999999999999999999…'
    """
    name, equals, value = change.partition("=")
    return f"{_cut(name, LONGEST_TARGET)}{equals}{_cut(value, LONGEST_VALUE)}"


def _cut(word: str, most: int) -> str:
    if not word.isprintable():
        return shown(word, most)
    return word if len(word) <= most else f"{word[:most]}…"


def _lay_source(file: YamlFile, nodes: Any, spec: GraphSpec, path: Path) -> None:
    over = source_document(path)
    found = [name for name, node in spec.nodes.items() if _makes_frames(node)]
    if len(found) != 1:
        names = f": {', '.join(found)}" if found else ""
        what = "--source needs one node that makes frames"
        raise GraphError(f"{file.path}: {what}, got {len(found)}{names}")
    entry: YamlMapping = nodes[found[0]]
    for key in ("operator", "settings"):
        if key in over.document:
            entry.put(key, over.document[key], over.document.places[key])
    _reroute(nodes, over)
    _add_nodes(file, nodes, over, entry.get("host"))


def _reroute(nodes: Any, over: YamlFile) -> None:
    """Let the graph's own nodes read what the source file names `instead` of another output."""
    instead = over.document.get("instead", {})
    known = (*nodes, *over.document.get("nodes", {}))
    for origin, target in instead.items():
        node = target.partition(".")[0]
        if node not in known:
            what = f"source.instead.{shown_key(origin)}: no node {shown_key(node)}"
            over.fail(instead, origin, what + suggest(node, known))
    for entry in nodes.values():
        inputs: YamlMapping = entry.get("inputs") or YamlMapping()
        for name, edge in list(inputs.items()):
            parent, key = (edge, "from") if isinstance(edge, YamlMapping) else (inputs, name)
            origin = str(parent.get(key))
            if origin in instead:
                parent.put(key, instead[origin], over.at(instead, origin))


def _add_nodes(file: YamlFile, nodes: Any, over: YamlFile, host: str | None) -> None:
    """Add the nodes of the source file, on the host of the sensor unless they name one."""
    added = over.document.get("nodes", {})
    for name, entry in added.items():
        if name in nodes:
            what = f"source.nodes.{shown_key(name)}: {file.path} has a node of that name"
            over.fail(added, name, what)
        if host is not None and isinstance(entry, YamlMapping) and "host" not in entry:
            entry.put("host", host, over.at(added, name))
        nodes.put(name, entry, over.at(added, name))


def _makes_frames(node: NodeSpec) -> bool:
    try:
        return issubclass(load_operator(node.operator), Source)
    except GraphError:
        return False


def _settings_of(file: YamlFile, entry: Mapping[str, Any], node: str) -> set[str]:
    where = f"{file.at(entry, 'operator')}: {node}.operator"
    return {f.name for f in fields(settings_of(load_operator(entry["operator"], where)))}


def _lay_value(file: YamlFile, nodes: Any, place: str, name: str, setting: str, value: Any) -> None:
    if name not in nodes:
        what = f"{file.path} has no node {shown_key(name)}{suggest(name, nodes)}"
        raise GraphError(f"{place}: {what}")
    entry: YamlMapping = nodes[name]
    names = _settings_of(file, entry, name)
    keys = setting.split(".")
    if keys[0] not in names and "options" in names:
        keys = ["options", *keys]
    parent = entry
    for key in ("settings", *keys[:-1]):
        if parent.get(key) is None:
            parent.put(key, YamlMapping(place), parent.places.get(key, place))
        if not isinstance(parent[key], Mapping):
            got = kind_of(parent[key])
            raise GraphError(f"{place}: {name}.{key}: expected a mapping to change, got {got}")
        parent = parent[key]
    parent.put(keys[-1], value, place)
