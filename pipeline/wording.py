"""Format untrusted values for error messages: truncated, on one line, without raising."""

from pipeline.naming import is_name
from pipeline.text import harmless

LONGEST = 80  # characters of a value in a sentence


def shown(value: object, longest: int = LONGEST) -> str:
    """Return a value as an error message shows it.

    >>> shown("a" * 100, 10), shown(float("nan")), shown(10**5000)
    ("'aaaaaaaaa…", 'nan', 'a int')
    """
    try:
        text = repr(value)
    except Exception:  # raised for a huge integer, or by the value's own __repr__
        return f"a {type(value).__name__}"
    plain = harmless(text[: longest + 1], longest + 1)
    return plain if len(text) <= longest else f"{plain[:longest]}…"


def shown_key(key: object) -> str:
    """Return a key as part of a dotted place: a name as it is, anything else in quotes.

    >>> shown_key("rate_hz"), shown_key("a b"), shown_key(5)
    ('rate_hz', "'a b'", '5')
    """
    return str(key) if is_name(key) else shown(key, 40)
