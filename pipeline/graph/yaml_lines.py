"""A parsed YAML file with the line of every key, for errors with file and line."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from pipeline.errors import GraphError
from pipeline.graph.yaml_reader import YamlMapping, read_file
from pipeline.settings import suggest
from pipeline.wording import shown_key


class YamlFile:
    """A YAML document with the line of every key; raises `GraphError` unless it is a mapping."""

    def __init__(self, path: Path) -> None:
        self.path = path
        document = read_file(path)
        if not isinstance(document, YamlMapping):
            raise GraphError(f"{path}:1: expected a mapping, got {kind_of(document)}")
        self.document = document

    def at(self, parent: Any, key: str) -> str:
        """Return `file:line` of a key, or of its parent when the key is missing."""
        if isinstance(parent, YamlMapping):
            return parent.places.get(key) or parent.place
        return str(self.path)

    def deepest(self, parent: Any, keys: Sequence[str]) -> str:
        """Return `file:line` of the innermost existing one of these nested keys."""
        place = self.at(parent, "")
        for key in keys:
            if not isinstance(parent, YamlMapping) or key not in parent:
                break
            place, parent = parent.places[key], parent[key]
        return place

    def fail(self, parent: Any, key: str, what: str) -> NoReturn:
        """Raise `GraphError` beginning with file and line."""
        raise GraphError(f"{self.at(parent, key)}: {what}")

    def mapping(self, parent: Any, key: str, where: str) -> Any:
        """Return a nested mapping; raises `GraphError` for any other value."""
        value = parent.get(key)
        if not isinstance(value, Mapping):
            what = f"{where}.{shown_key(key)}: expected a mapping, got {kind_of(value)}"
            self.fail(parent, key, what)
        return value

    def only(self, mapping: Any, known: Iterable[str], where: str) -> None:
        """Raise `GraphError` for unknown keys."""
        known = tuple(known)
        for key in mapping:
            if key not in known:
                hint = suggest(str(key), known)
                self.fail(mapping, key, f"{where}.{shown_key(key)}: no such key{hint}")


def kind_of(value: object) -> str:
    """Return the kind of a value for an error message."""
    if value is None:
        return "nothing"
    return "a mapping" if isinstance(value, Mapping) else type(value).__name__


def plain(value: Any) -> Any:
    """Return the same value without line numbers."""
    if isinstance(value, Mapping):
        return {k: plain(v) for k, v in value.items()}
    return [plain(v) for v in value] if isinstance(value, list) else value
