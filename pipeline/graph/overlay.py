"""What a command line lays over a graph file: another source, single values, manual nodes."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.error import YAMLError

from pipeline.contract import Source, settings_of
from pipeline.errors import GraphError
from pipeline.graph.plan import load_operator
from pipeline.graph.yaml_lines import YamlFile
from pipeline.settings import suggest


@dataclass(frozen=True)
class Overlay:
    """What a command line lays over a graph file."""

    source: Path | None = None  # a YAML file with `settings` and perhaps `operator`
    changes: tuple[str, ...] = ()  # node.setting=value
    clock: str = ""
    wanted: tuple[str, ...] = ()  # manual nodes to start

    def lay(self, file: YamlFile, nodes: Any) -> None:
        """Change the parsed nodes in place; raises `GraphError` for what fits nothing."""
        if self.source:
            _lay_source(file, nodes, self.source)
        for change in self.changes:
            _lay_change(nodes, change, file.path)
        for name in self.wanted:
            if name not in nodes:
                raise GraphError(f"{file.path}: no node {name}{suggest(name, nodes)}")


def manual_nodes(path: Path, setting: str) -> list[str]:
    """Nodes that start only on request and have that setting."""
    nodes = YamlFile(path).document.get("nodes") or {}
    found = []
    for name, entry in nodes.items():
        if isinstance(entry, Mapping) and entry.get("manual"):
            cls = settings_of(load_operator(str(entry.get("operator"))))
            if setting in {f.name for f in fields(cls)}:
                found.append(str(name))
    return found


def _lay_source(file: YamlFile, nodes: Any, path: Path) -> None:
    over = YamlFile(path)
    over.only(over.document, ("operator", "settings"), "source")
    found = [n for n in nodes if _makes_frames(nodes[n])]
    if len(found) != 1:
        raise GraphError(
            f"{file.path}: --source needs one node that makes frames, got {len(found)}"
        )
    entry = nodes[found[0]]
    for key in over.document:
        entry[key] = over.document[key]


def _makes_frames(entry: Any) -> bool:
    try:
        return issubclass(load_operator(str(entry.get("operator"))), Source)
    except (GraphError, AttributeError):
        return False


def read_change(change: str) -> tuple[str, str, Any]:
    """Node, setting and value of `node.setting=value`; raises `GraphError` for anything else.

    >>> read_change("policy.prompt_box=[1, 2, 3, 4]")
    ('policy', 'prompt_box', [1, 2, 3, 4])
    """
    target, equals, text = change.partition("=")
    node, dot, setting = target.partition(".")
    if not (equals and dot and node and setting):
        raise GraphError(f"{change}: expected node.setting=value")
    return node, setting, read_value(text)


def read_value(text: str) -> Any:
    """What a YAML file would mean by it; raises `GraphError`.

    >>> read_value("[1, 2]"), read_value("off"), read_value("")
    ([1, 2], 'off', '')
    """
    try:
        return YAML(typ="safe").load(text) if text else ""
    except YAMLError as error:
        raise GraphError(f"{text}: not a value: {error}") from error


def _lay_change(nodes: Any, change: str, path: Path) -> None:
    try:
        name, setting, value = read_change(change)
    except GraphError as error:
        raise GraphError(f"--set {error}") from error
    if name not in nodes:
        raise GraphError(f"--set {change}: {path} has no node {name}{suggest(name, nodes)}")
    entry = nodes[name]
    settings = entry.setdefault("settings", CommentedMap())
    cls = settings_of(load_operator(str(entry.get("operator"))))
    names = {f.name for f in fields(cls)}
    first, *rest = setting.split(".")
    if first not in names and "options" in names:
        first, rest = "options", [first, *rest]
    for key in (first, *rest)[:-1]:
        settings = settings.setdefault(key, CommentedMap())
    settings[(first, *rest)[-1]] = value
