r"""Frame messages as lines of a byte stream, so that garbage ends with its line.

>>> as_line(b"a\nb\x1b")
b'a\x1b1b\x1b0\n'
>>> from_line(as_line(b"a\nb\x1b").removesuffix(b"\n"))
b'a\nb\x1b'
"""

ESCAPE, ESCAPED, BREAK = b"\x1b", b"\x1b0", b"\x1b1"


def as_line(data: bytes) -> bytes:
    """Encode bytes as a line, including its end."""
    return data.replace(ESCAPE, ESCAPED).replace(b"\n", BREAK) + b"\n"


def from_line(line: bytes) -> bytes:
    """Decode a line without its end."""
    return line.replace(BREAK, b"\n").replace(ESCAPED, ESCAPE)
