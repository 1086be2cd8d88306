"""Sanitise text from user code before it is logged, shown or sent on.

Exception texts, headlines and summaries come from operators: they may be huge, contain terminal
control characters or lone surrogates that no file accepts, or raise when they are converted.
"""

import unicodedata
from collections.abc import Mapping
from typing import Any

MOST_CHARS = 1000  # of a displayed sentence; the node's log has the whole text
MOST_DEPTH = 32  # nested levels of figures
WHOLE_LOW, WHOLE_HIGH = -(1 << 63), (1 << 64) - 1  # the integers that messages can carry
_UNPRINTABLE = {"Cc", "Cs", "Cf", "Co", "Cn", "Zl", "Zp"}


def harmless(text: str, most_chars: int = MOST_CHARS, *, lines: bool = False) -> str:
    r"""Return the text in printable characters, truncated; `lines` keeps line breaks.

    >>> harmless("a\x1b[2J\ud800b\nc")
    'a\\x1b[2J\\ud800b c'
    >>> harmless("x" * 12, 10)
    'xxxxxxxxxx… (2 characters more)'
    """
    more = len(text) - most_chars
    kept = text[:most_chars]
    if not kept.isascii() or not kept.isprintable():
        kept = "".join(_printable(c, lines=lines) for c in kept)
    return f"{kept}… ({more} characters more)" if more > 0 else kept


def error_text(error: BaseException) -> str:
    """Return an exception's type and text, even when `str` of it fails.

    >>> error_text(ValueError("no"))
    'ValueError: no'
    """
    return f"{type(error).__name__}: {said_by(error)}"


def said_by(error: BaseException) -> str:
    """Return an exception's text, even when `str` of it fails."""
    try:
        return str(error)
    except Exception as broken:  # an operator's class may do anything
        return f"(its text cannot be had: {type(broken).__name__})"


def plain(value: Any, depth: int = MOST_DEPTH, most_chars: int = MOST_CHARS) -> Any:
    r"""Return JSON values with sanitised strings and keys, truncated where too deep or too long.

    >>> plain({"a": ["b\x00", 1.5, None]})
    {'a': ['b\\x00', 1.5, None]}
    """
    if isinstance(value, str):
        return harmless(value, most_chars, lines=True)
    if isinstance(value, int) and not WHOLE_LOW <= value <= WHOLE_HIGH:
        return harmless(str(value))
    if not isinstance(value, (Mapping, list)):
        return value
    if depth == 0:
        return "…"
    if isinstance(value, Mapping):
        return {harmless(str(k)): plain(v, depth - 1, most_chars) for k, v in value.items()}
    return [plain(v, depth - 1, most_chars) for v in value]


def _printable(character: str, *, lines: bool) -> str:
    if character in "\n\r\t":
        return "\n" if lines and character == "\n" else " "
    if unicodedata.category(character) not in _UNPRINTABLE or character in "\u200c\u200d\u00ad":
        return character
    return ascii(character)[1:-1]
