"""Files of labels: a path in, its text or JSON out; and where in a JSON file something is."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers import regular_file
from pipeline.errors import DriverError

MOST_BYTES = 1 << 30  # of a file
MOST_SHOWN = 60  # characters of a value in a sentence
SPACE = " \t\r\n"  # between the parts of JSON
Key = str | int


def read_text(path: Path) -> str:
    """Return a file's text, in UTF-8 with or without mark; raises `DriverError`."""
    try:
        return regular_file.read_text(path, MOST_BYTES, "utf-8-sig")
    except UnicodeError as error:
        raise DriverError(f"{path}: expected UTF-8: {error}") from error


def read_json(path: Path) -> Any:
    """Return what a JSON file holds; raises `DriverError` with the line."""
    try:
        return json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise DriverError(f"{path}:{error.lineno}: expected JSON: {error.msg}") from error
    except RecursionError as error:
        raise DriverError(f"{path}: expected JSON, got too many levels") from error
    except ValueError as error:  # Python reads no number of more digits
        raise DriverError(f"{path}: expected JSON with numbers of at most 4300 digits") from error


def brief(value: Any) -> str:
    """Return the beginning of a value for a sentence: it may be as long as its file.

    >>> brief("x" * 1000)[-3:]
    'xx…'
    """
    text = repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"


@dataclass(frozen=True)
class Place:
    """A part of a JSON file; as text it has the line, for which the file is read once more."""

    path: Path
    keys: tuple[Key, ...] = ()

    def __truediv__(self, key: Key) -> "Place":
        """Return the place of what is under a key of this one."""
        return Place(self.path, (*self.keys, key))

    def __str__(self) -> str:
        """Return file, line and keys; the line of what is around a part that is not there."""
        if not self.keys:
            return str(self.path)
        try:
            where = f"{self.path}:{line_of(read_text(self.path), self.keys)}"
        except (DriverError, ValueError, IndexError, RecursionError):  # changed meanwhile
            where = str(self.path)
        shown = (f"[{k}]" if isinstance(k, int) else f".{k[:MOST_SHOWN]}" for k in self.keys)
        named = "".join(shown)
        return f"{where}: {named.removeprefix('.')}"


def line_of(text: str, keys: Sequence[Key]) -> int:
    r"""Return the line, from 1, on which a part of a JSON document begins.

    >>> line_of('{"a": [\n1,\n{"b": 2}]}', ["a", 1, "b"]), line_of("\n[]", [3])
    (3, 2)
    """
    at = _skip(text, 0)
    for key in keys:
        found = _inside(text, at, key)
        if found is None:
            break
        at = found
    return text.count("\n", 0, at) + 1


def _inside(text: str, at: int, key: Key) -> int | None:
    """Return where the value of a key begins in the object or list at a position."""
    decoder, named, number = json.JSONDecoder(), text[at] == "{", 0
    if text[at] not in "{[":
        return None
    at = _skip(text, at + 1)
    while text[at] not in "}]":
        name: Key = number
        if named:
            name, at = decoder.raw_decode(text, at)
            at = _skip(text, _skip(text, at) + 1)  # behind the colon
        if name == key:
            return at
        at = _skip(text, decoder.raw_decode(text, at)[1])
        if text[at] == ",":
            at = _skip(text, at + 1)
        number += 1
    return None


def _skip(text: str, at: int) -> int:
    """Return the position of the next character that is no space."""
    while at < len(text) and text[at] in SPACE:
        at += 1
    return at
