"""Decode messages by the schema that their sender announces, without importing their class.

A schema is a text `Name(field:kind,…)` as in `pipeline.codec`: the fields in order, and which of
them hold arrays. As there, bytes are untrusted: whatever does not match raises `MessageError`.
"""

import hashlib
import math
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from pipeline import codec
from pipeline.errors import MessageError
from pipeline.fields import DTYPES, Fetch
from pipeline.messages import Header

MOST_TEXT = 20_000  # characters of a schema
MOST_DEPTH = 16  # nested levels of kinds
OPENS, CLOSES = "([", ")]"


@dataclass(frozen=True)
class Described:
    """A decoded message: its header, and the values of its other fields by name."""

    header: Header
    values: dict[str, Any]  # arrays are arrays, dataclasses are mappings


class Description:
    """A schema that decodes messages."""

    def __init__(self, text: str) -> None:
        """Parse a schema; raises `MessageError` for an invalid one."""
        if len(text) > MOST_TEXT:
            raise MessageError(f"schema: expected up to {MOST_TEXT} characters, got {len(text)}")
        self.fingerprint = hashlib.sha256(text.encode()).digest()[:8]
        self.name, self._fields = fields_of(text)
        if "header" not in self._fields:
            raise MessageError(f"schema: {self.name[:80]}: expected a header, got none")

    def read(self, data: codec.Buffer, fetch: Fetch) -> Described:
        """Decode untrusted bytes; arrays are views of what `fetch` returns."""
        whole = codec.parse(msgspec.msgpack.decode, data, self.name)
        values = _whole(whole, self._fields, fetch, self.name)
        header = codec.unpack(Header, codec.to_bytes(values.pop("header")))
        return Described(header, values)


def fields_of(text: str) -> tuple[str, dict[str, str]]:
    """Return name and field kinds of `Name(field:kind,…)`; raises `MessageError`.

    >>> fields_of("Spot(header:Header(seq:int),at:array[<f4](n,2),word:str)")[1]["at"]
    'array[<f4](n,2)'
    """
    name, opened, rest = text.partition("(")
    if not (name.isidentifier() and opened and rest.endswith(")")):
        raise MessageError(f"expected Name(field:kind,…), got {text[:80]!r}")
    found = {}
    for part in _split(rest[:-1]):
        field, colon, kind = part.partition(":")
        if not (colon and field.isidentifier() and kind):
            raise MessageError(f"{name}: expected field:kind, got {part[:80]!r}")
        found[field] = kind
    return name, found


def _split(text: str) -> list[str]:
    """Split at commas outside brackets."""
    parts, depth, first = [], 0, 0
    for place, letter in enumerate(text):
        depth += (letter in OPENS) - (letter in CLOSES)
        if depth < 0:
            raise MessageError("expected brackets in pairs")
        if letter == "," and not depth:
            parts.append(text[first:place])
            first = place + 1
    return [*parts, text[first:]] if text else []


def _whole(
    item: Any, kinds: dict[str, str], fetch: Fetch, where: str, depth: int = 0
) -> dict[str, Any]:
    if isinstance(item, dict) and item.keys() == kinds.keys():
        items = item
    elif isinstance(item, list) and len(item) == len(kinds):
        items = dict(zip(kinds, item, strict=True))
    else:
        raise MessageError(f"{where}: expected {len(kinds)} fields, got something else")
    return {
        name: _value(items[name], kind, fetch, f"{where}.{name}", depth + 1)
        for name, kind in kinds.items()
    }


def _value(item: Any, kind: str, fetch: Fetch, where: str, depth: int) -> Any:
    if depth > MOST_DEPTH:
        raise MessageError(f"{where}: expected up to {MOST_DEPTH} levels")
    if kind.startswith("array["):
        return _array(item, fetch, where)
    if "array[" not in kind:  # numbers, strings, and tuples and mappings of them
        return item
    if kind.startswith("tuple"):
        size, _, inner = kind.removeprefix("tuple").partition("[")
        kinds = _split(inner.removesuffix("]"))
        if not isinstance(item, list) or not kinds:
            raise MessageError(f"{where}: expected a list")
        kinds = kinds * len(item) if size == "*" else kinds
        if len(kinds) != len(item):
            raise MessageError(f"{where}: expected {len(kinds)} items, got {len(item)}")
        pairs = zip(item, kinds, strict=True)
        return [_value(part, of, fetch, where, depth + 1) for part, of in pairs]
    return _whole(item, fields_of(kind)[1], fetch, where, depth)


def _array(item: Any, fetch: Fetch, where: str) -> np.ndarray[Any, Any]:
    if not isinstance(item, list) or len(item) != 3 or not isinstance(item[1], list):
        raise MessageError(f"{where}: expected an array")
    kind, sides, spot = item
    if kind not in DTYPES or not all(type(side) is int and side >= 0 for side in sides):
        raise MessageError(f"{where}: expected type and sides of an array")
    nbytes = DTYPES[kind].itemsize * math.prod(sides)
    if isinstance(spot, bytes):
        raw = np.frombuffer(spot, np.uint8)
    elif type(spot) is int and spot >= 0:
        raw = fetch(spot, nbytes)
    else:
        raise MessageError(f"{where}: expected bytes or where they begin")
    if raw.nbytes != nbytes:
        raise MessageError(f"{where}: expected {nbytes} bytes, got {raw.nbytes}")
    try:
        array: np.ndarray[Any, Any] = np.ndarray(sides, DTYPES[kind], raw)
    except (ValueError, OverflowError) as error:
        raise MessageError(f"{where}: no array has the sides {sides}") from error
    return array
