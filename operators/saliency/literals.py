"""Parse literals as Python or JSON prints them: the text of a network's metadata -> plain values.

Exporters write `{0: 'person', 1: 'dog'}`, `[640, 640]` or `True`. The text is a stranger's: nothing
of it is evaluated, and its length, its depth and the number of its values are limited.
"""

import math
import re
from collections.abc import Callable
from typing import TypeAlias

from pipeline.wording import shown

MOST_CHARS = 1 << 18
MOST_VALUES = 50_000
DEEPEST = 8  # levels
WORDS = {"True": True, "true": True, "False": False, "false": False, "None": None, "null": None}
Scalar: TypeAlias = bool | int | float | str | None
Value: TypeAlias = "Scalar | list[Value] | dict[int | str, Value]"

_TOKEN = re.compile(
    r"""\s*(?:
    (?P<mark>[][(){},:])
    | '(?P<single>(?:[^'\\\n]|\\.)*+)'
    | "(?P<double>(?:[^"\\\n]|\\.)*+)"
    | (?P<number>[+-]?(?:\d{1,18}(?:\.\d{0,30})?|\.\d{1,30})(?:[eE][+-]?\d{1,3})?)(?![\w.])
    | (?P<word>[A-Za-z]{1,5})(?!\w)
    | (?P<end>$)
    )""",
    re.VERBOSE,
)
_ESCAPE = re.compile(r"\\(x[0-9a-fA-F]{2}|u[0-9a-fA-F]{4}|U[0-9a-fA-F]{8}|.)")
_ESCAPED = {"n": "\n", "t": "\t", "r": "\r", "b": "\b", "f": "\f"} | {c: c for c in "\\'\"/"}
_CLOSING = {"[": "]", "(": ")", "{": "}"}


def parse(text: str) -> Value:
    r"""Return the value of a literal; tuples become lists. Raises `ValueError` with a sentence.

    >>> parse("{0: 'person', 1: 'potted plant'}"), parse("(640, 480)"), parse('{"half": true}')
    ({0: 'person', 1: 'potted plant'}, [640, 480], {'half': True})
    """
    if len(text) > MOST_CHARS:
        raise ValueError(f"expected up to {MOST_CHARS} characters, got {len(text)}")
    return _Parser(text).whole()


class _Parser:
    """Reads one value, token by token."""

    def __init__(self, text: str) -> None:
        self._text, self._at, self._count = text, 0, 0
        self._next()

    def whole(self) -> Value:
        """Return the only value of the text."""
        value = self._value(1)
        if self._kind != "end":
            raise self._wrong("the end")
        return value

    def _next(self) -> None:
        self._start = self._at
        found = _TOKEN.match(self._text, self._at)
        if found is None:
            raise self._wrong("a value")
        self._kind, self._at = str(found.lastgroup), found.end()
        self._token = found[self._kind]

    def _is(self, mark: str) -> bool:
        return self._kind == "mark" and self._token == mark

    def _wrong(self, expected: str) -> ValueError:
        rest = self._text[self._start : self._start + 60].strip()
        got = shown(rest, 24) if rest else "the end"
        return ValueError(f"expected {expected} at character {self._start + 1}, got {got}")

    def _value(self, depth: int) -> Value:
        self._count += 1
        if depth > DEEPEST:
            raise self._wrong(f"up to {DEEPEST} levels")
        if self._count > MOST_VALUES:
            raise self._wrong(f"up to {MOST_VALUES} values")
        if self._kind == "mark" and self._token in _CLOSING:
            return self._table(depth) if self._token == "{" else self._list(depth)
        return self._scalar()

    def _scalar(self) -> Scalar:
        kind, token = self._kind, self._token
        value: Scalar
        if kind == "number":
            value = float(token) if set(token) & set(".eE") else int(token)
        elif kind in ("single", "double"):
            value = _ESCAPE.sub(self._unescaped, token)
        elif kind == "word" and token in WORDS:
            value = WORDS[token]
        else:
            raise self._wrong("a value")
        if isinstance(value, float) and not math.isfinite(value):
            raise self._wrong("a finite number")
        self._next()
        return value

    def _unescaped(self, found: re.Match[str]) -> str:
        code = found[1]
        if len(code) > 1 and int(code[1:], 16) <= 0x10FFFF:
            return chr(int(code[1:], 16))
        if code not in _ESCAPED:
            raise self._wrong("a known escape sequence")
        return _ESCAPED[code]

    def _list(self, depth: int) -> list[Value]:
        values: list[Value] = []
        self._until(_CLOSING[self._token], lambda: values.append(self._value(depth + 1)))
        return values

    def _table(self, depth: int) -> dict[int | str, Value]:
        values: dict[int | str, Value] = {}

        def item() -> None:
            self._count += 1
            before, key = self._start, self._scalar()
            if isinstance(key, (bool, float)) or key is None or key in values:
                self._start = before
                raise self._wrong("another whole number or text as a key")
            if not self._is(":"):
                raise self._wrong("a colon")
            self._next()
            values[key] = self._value(depth + 1)

        self._until("}", item)
        return values

    def _until(self, closing: str, item: Callable[[], None]) -> None:
        """Read items with commas between them; one more at the end is allowed."""
        self._next()
        while not self._is(closing):
            item()
            if self._is(","):
                self._next()
            elif not self._is(closing):
                raise self._wrong(f"a comma or {closing}")
        self._next()
