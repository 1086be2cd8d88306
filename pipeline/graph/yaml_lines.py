"""A YAML mapping that knows the line of every key, and complains with file and line."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from pipeline.errors import GraphError
from pipeline.settings import suggest


class YamlFile:
    """A YAML mapping that knows the line of every key."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            document = YAML(typ="rt").load(path.read_text("utf-8"))
        except OSError as error:
            raise GraphError(f"{path}: cannot be read: {error.strerror}") from error
        except MarkedYAMLError as error:
            line = (error.problem_mark.line + 1) if error.problem_mark else 1
            raise GraphError(f"{path}:{line}: not YAML: {error.problem}") from error
        except (YAMLError, UnicodeDecodeError) as error:
            raise GraphError(f"{path}:1: not YAML: {error}") from error
        if not isinstance(document, CommentedMap):
            raise GraphError(f"{path}:1: expected a mapping, got {type(document).__name__}")
        self.document = document

    def at(self, parent: Any, key: str) -> str:
        """`file:line` of a key, or of its parent when it is not there."""
        try:
            line = parent.lc.key(key)[0] if key in parent else parent.lc.line
        except (AttributeError, KeyError, TypeError):
            return str(self.path)  # laid over from the command line
        return f"{self.path}:{line + 1}"

    def fail(self, parent: Any, key: str, what: str) -> NoReturn:
        """Raise with the place in front."""
        raise GraphError(f"{self.at(parent, key)}: {what}")

    def mapping(self, parent: Any, key: str, where: str) -> Any:
        """A nested mapping."""
        value = parent.get(key)
        if not isinstance(value, Mapping):
            got = "nothing" if value is None else type(value).__name__
            self.fail(parent, key, f"{where}.{key}: expected a mapping, got {got}")
        return value

    def only(self, mapping: Any, known: Iterable[str], where: str) -> None:
        """Refuse keys that mean nothing."""
        known = tuple(known)
        for key in mapping:
            if key not in known:
                hint = suggest(str(key), known)
                self.fail(mapping, key, f"{where}.{key}: no such key{hint}")


def plain(value: Any) -> Any:
    """Without the parser's own types."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [plain(v) for v in value]
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return kind(value)
    return value
