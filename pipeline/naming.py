"""Names that become part of a path, a key expression or a socket: one grammar for all of them.

It applies to graphs, nodes, groups, hosts, inputs and outputs, whether the name comes from a graph
file, a command line, a run folder, a recording or another host. A name can therefore neither escape
from the folder that it is used in nor match more than one key.
"""

import re

from pipeline.errors import FoveaError, GraphError

LONGEST_NAME = 32  # the address of a unix socket has room for 107 bytes, folders included
GRAMMAR = rf"[A-Za-z0-9_][A-Za-z0-9_-]{{0,{LONGEST_NAME - 1}}}"
_NAME = re.compile(GRAMMAR)


def is_name(value: object) -> bool:
    """Whether a value is a valid name.

    >>> is_name("main-camera_2"), is_name("../etc"), is_name(""), is_name(None)
    (True, False, False, False)
    """
    return isinstance(value, str) and _NAME.fullmatch(value) is not None


def check_name(value: object, where: str, error: type[FoveaError] = GraphError) -> str:
    """Return the value if it is a valid name; else raise `error` beginning with `where`.

    >>> check_name("a/b", "graph.name")
    Traceback (most recent call last):
    pipeline.errors.GraphError: graph.name: expected up to 32 letters, digits, - and _, got 'a/b'
    """
    if isinstance(value, str) and is_name(value):
        return value
    if isinstance(value, str):
        got = repr(value) if len(value) <= 2 * LONGEST_NAME else f"{value[: 2 * LONGEST_NAME]!r}…"
    else:
        got = "nothing" if value is None else type(value).__name__
    raise error(f"{where}: expected up to {LONGEST_NAME} letters, digits, - and _, got {got}")
