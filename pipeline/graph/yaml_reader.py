"""Parse untrusted YAML to plain values, with limits; the only place that reads YAML.

A document is composed from the parser's events and refused as soon as it is too large, too deep or
uses a feature that graphs do not need: tags, several documents, repeated keys, numbers beyond 64
bits. Aliases are copied, so that no two places share a value, and count with their full size.
"""

import math
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentEndEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
    StreamEndEvent,
)
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.scanner import Scanner

from pipeline.errors import GraphError
from pipeline.text import harmless
from pipeline.wording import shown, shown_key

MOST_BYTES = 1 << 18
MOST_VALUES = 20_000  # aliases expanded
DEEPEST = 32  # levels
TOO_DEEP = f"expected up to {DEEPEST} levels, got more"
LONGEST_NUMBER = 400  # characters; a longer one exceeds even the range of a float
WHOLE_LOW, WHOLE_HIGH = -(1 << 63), (1 << 64) - 1  # the integers that messages can carry
_FORBIDDEN = re.compile(
    "[^\t\n\r -~\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"  # YAML 1.2, section 5.1
)
_BASES = {"0b": 2, "0o": 8, "0x": 16}


class YamlMapping(dict[str, Any]):
    """A mapping with the position of itself and each key, as `file:line`."""

    def __init__(self, place: str = "") -> None:
        super().__init__()
        self.place = place
        self.places: dict[str, str] = {}

    def put(self, key: str, value: Any, place: str) -> None:
        """Set a key and its position."""
        self[key] = value
        self.places[key] = place


def read_file(path: Path) -> Any:
    """Return the value of a YAML file; raises `GraphError` with file and line."""
    data = _bytes_of(path)
    text = data.decode("utf-8-sig", "replace")
    return _read(text, lambda line: f"{path}:{line + 1}", "not YAML: ", data)


def read_text(text: str, what: str) -> Any:
    """Parse YAML text, e.g. of a command line; raises `GraphError` beginning with `what`."""
    return _read(text, lambda _line: what, "", None)


def _bytes_of(path: Path) -> bytes:
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # never blocks on a pipe
        kind = os.fstat(handle).st_mode
        if not stat.S_ISREG(kind):
            os.close(handle)
            got = "a folder" if stat.S_ISDIR(kind) else "no regular file"
            raise GraphError(f"{path}: cannot be read: expected a file, got {got}")
        with open(handle, "rb") as file:
            return file.read(MOST_BYTES + 1)
    except OSError as error:
        raise GraphError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # a NUL in its name
        raise GraphError(f"{shown(str(path))}: cannot be read: {error}") from error


def _read(text: str, at: Callable[[int], str], word: str, data: bytes | None) -> Any:
    size = len(text) if data is None else len(data)
    if size > MOST_BYTES:
        raise GraphError(f"{at(0)}: expected up to {MOST_BYTES} bytes of YAML, got more")
    if found := _FORBIDDEN.search(text):
        line = text.count("\n", 0, found.start())
        raise GraphError(f"{at(line)}: {word}the character U+{ord(found[0]):04X} is not allowed")
    if data is not None:
        try:
            data.decode()
        except UnicodeDecodeError as error:
            line = data.count(b"\n", 0, error.start)
            raise GraphError(f"{at(line)}: {word}expected UTF-8: {error.reason}") from error
    composer = _Composer(text, at)
    try:
        return composer.document()
    except GraphError:
        raise
    except _TooDeep as error:
        raise GraphError(f"{at(error.line)}: {TOO_DEEP}") from error
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line if mark else composer.line
        problem = harmless(error.problem or error.context or "it cannot be read", 200)
        raise GraphError(f"{at(line)}: {word}{problem}") from error
    except (YAMLError, ValueError, OverflowError, LookupError, AttributeError) as error:
        raise GraphError(f"{at(composer.line)}: {word}{harmless(str(error), 200)}") from error


class _TooDeep(Exception):
    """Nesting too deep; raised by the scanner, which reads ahead of the events."""

    def __init__(self, line: int) -> None:
        super().__init__()
        self.line = line


class _Scanner(Scanner):
    """Limits nested brackets, for which the scanner takes quadratic time."""

    def fetch_flow_collection_start(self, TokenClass: Any, to_push: str) -> None:  # noqa: N803
        """Handle an opening bracket."""
        if self.flow_level >= DEEPEST:
            raise _TooDeep(self.reader.line)
        super().fetch_flow_collection_start(TokenClass, to_push)


class _Composer:
    """Builds one value from the events of the parser, with limits on each."""

    def __init__(self, text: str, at: Callable[[int], str]) -> None:
        yaml = YAML(typ="safe", pure=True)
        yaml.Scanner = _Scanner
        self._events: Iterator[Event] = iter(yaml.parse(text))
        self._resolve = yaml.resolver.resolve
        self._at = at
        self._anchors: dict[str, tuple[Any, int] | None] = {}  # value and size; None: not complete
        self._count = 0
        self.line = 0  # of the latest event

    def document(self) -> Any:
        """Return the value of the only document; None for an empty text."""
        self._next()
        event = self._next()
        if isinstance(event, StreamEndEvent):
            return None
        assert isinstance(event, DocumentStartEvent)
        if event.version not in (None, (1, 2)):
            self._fail(f"expected YAML 1.2, got {'.'.join(map(str, event.version))}")
        value = self._value(self._next(), 1)
        assert isinstance(self._next(), DocumentEndEvent)
        if not isinstance(self._next(), StreamEndEvent):
            self._fail("expected one document, got another one")
        return value

    def _next(self) -> Event:
        event = next(self._events)
        self.line = event.start_mark.line
        return event

    def _fail(self, what: str) -> NoReturn:
        raise GraphError(f"{self._at(self.line)}: {what}")

    def _grow(self, values: int) -> None:
        self._count += values
        if self._count > MOST_VALUES:
            self._fail(f"expected up to {MOST_VALUES} values, got more, aliases written out")

    def _value(self, event: Event, depth: int) -> Any:
        if depth > DEEPEST:
            self._fail(TOO_DEEP)
        if isinstance(event, AliasEvent):
            return self._alias(event.anchor, depth)
        assert isinstance(event, (ScalarEvent, SequenceStartEvent, MappingStartEvent))
        before, anchor = self._count, event.anchor
        self._grow(1)
        if event.tag is not None:
            self._fail(f"expected no tag, got {shown(str(event.tag))}")
        if anchor is not None:
            self._anchors[anchor] = None
        value: Any
        if isinstance(event, ScalarEvent):
            value = self._scalar(event)
        elif isinstance(event, SequenceStartEvent):
            value = [self._value(item, depth + 1) for item in self._until(SequenceEndEvent)]
        else:
            assert isinstance(event, MappingStartEvent)
            value = self._mapping(depth)
        if anchor is not None:
            self._anchors[anchor] = value, self._count - before
        return value

    def _until(self, end: type[Event]) -> Iterator[Event]:
        while not isinstance(event := self._next(), end):
            yield event

    def _alias(self, anchor: str, depth: int) -> Any:
        if anchor not in self._anchors:
            self._fail(f"no anchor {shown(anchor)}")
        known = self._anchors[anchor]
        if known is None:
            self._fail(f"the alias {shown(anchor)} stands within what it names")
        self._grow(known[1])
        return self._copied(known[0], depth)

    def _copied(self, value: Any, depth: int) -> Any:
        if depth > DEEPEST:
            self._fail(TOO_DEEP)
        if isinstance(value, YamlMapping):
            copy = YamlMapping(value.place)
            for key, item in value.items():
                copy.put(key, self._copied(item, depth + 1), value.places[key])
            return copy
        if isinstance(value, list):
            return [self._copied(item, depth + 1) for item in value]
        return value

    def _mapping(self, depth: int) -> YamlMapping:
        mapping, merged = YamlMapping(self._at(self.line)), list[YamlMapping]()
        for event in self._until(MappingEndEvent):
            place = self._at(self.line)
            merges = isinstance(event, ScalarEvent) and event.value == "<<" and event.implicit[0]
            key = self._value(event, depth + 1)
            if not isinstance(key, str):
                self._fail(f"expected a text as key, got {shown(key)}")
            if not merges and key in mapping:
                self._fail(f"expected every key once, got {shown_key(key)} again")
            value = self._value(self._next(), depth + 1)
            if merges:
                merged += self._merged(value)
            else:
                mapping.put(key, value, place)
        for more in merged:
            for key, value in more.items():
                if key not in mapping:
                    mapping.put(key, self._copied(value, depth + 1), more.places[key])
        return mapping

    def _merged(self, value: Any) -> Iterable[YamlMapping]:
        values = value if isinstance(value, list) else [value]
        if not all(isinstance(v, YamlMapping) for v in values):
            self._fail("<<: expected a mapping to merge, got something else")
        return values

    def _scalar(self, event: ScalarEvent) -> Any:
        text: str = event.value
        if any("\ud800" <= c <= "\udfff" for c in text):  # from an escape sequence
            self._fail(f"expected a text, got half a character in {shown(text)}")
        if not event.implicit[0]:
            return text
        kind = str(self._resolve(ScalarNode, text, event.implicit)).rpartition(":")[2]
        if kind == "null":
            return None
        if kind == "bool":
            return text.lower() == "true"
        if kind in ("int", "float"):
            return self._number(text, kind)
        return text  # dates, too: YAML 1.2 has no date type

    def _number(self, text: str, kind: str) -> int | float | str:
        if len(text) > LONGEST_NUMBER:
            self._fail(f"expected a number within 64 bits, got one of {len(text)} characters")
        digits = text.replace("_", "")
        try:
            number = (
                _whole(digits) if kind == "int" else float(digits.lower().replace(".inf", "inf"))
            )
        except ValueError:
            if digits.lower() != ".nan":
                return text
            number = math.nan
        if isinstance(number, int) and not WHOLE_LOW <= number <= WHOLE_HIGH:
            self._fail(f"expected a whole number within 64 bits, got {shown(text, 40)}")
        if not math.isfinite(number):
            self._fail(f"expected a finite number, got {shown(text, 40)}")
        return number


def _whole(digits: str) -> int:
    """Parse an integer of YAML 1.2: 10, +10, 0b1010, 0o12, 0xA."""
    sign = -1 if digits.startswith("-") else 1
    bare = digits.lstrip("+-")
    return sign * int(bare[2:] if bare[:2] in _BASES else bare, _BASES.get(bare[:2], 10))
