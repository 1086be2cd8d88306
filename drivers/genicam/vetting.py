"""Keeps descriptions from the library that would make it crash or never return: XML in, nodes out.

Aravis follows nodes that take their value from one another in a ring until its stack is full, and
ends the process when it cannot allocate what a register says is its length.
"""

from drivers.genicam.nodes import Node, NodeMap, parse_nodes, whole, wrong
from pipeline.text import harmless

LONGEST_CHAIN = 256  # nodes that take their value from one another
LONGEST_REGISTER = 1 << 16  # bytes; real cameras have up to 32768

# where a node's value comes from; the links of limits and locks lead into these
VALUE_LINKS = (
    "pValue", "pValueCopy", "pValueIndexed", "pValueDefault", "pIndex", "pVariable", "pAddress",
    "pLength", "pCommandValue",
)  # fmt: skip


def vetted_nodes(xml: bytes) -> NodeMap:
    """Read a description that the library may see; raises `DriverError` in one sentence."""
    found = parse_nodes(xml)
    for node in found.nodes.values():
        _check_length(node)
    _check_rings(found)
    return found


def _check_length(node: Node) -> None:
    for tag, _, text in node.fields:
        if tag != "Length":
            continue
        length = whole(text)
        if length is None or not 1 <= length <= LONGEST_REGISTER:
            place = harmless(node.name, 60)
            raise wrong(f"{place} of 1 to {LONGEST_REGISTER} bytes", harmless(text, 30) or "none")


def _check_rings(found: NodeMap) -> None:
    """Raise `DriverError` where following values does not end, or only after too many nodes."""
    depth: dict[str, int] = {}  # nodes below one that is known to end; -1: on the way to it
    for first in found.nodes:
        stack = [first]
        while stack:
            name = stack[-1]
            if depth.get(name, -1) >= 0:
                stack.pop()
                continue
            linked = [n for n in found.nodes[name].links(*VALUE_LINKS) if n in found.nodes]
            waiting = [n for n in linked if depth.get(n, -2) < 0]
            if any(depth.get(n) == -1 for n in waiting):
                raise wrong("values that end in a register", f"{harmless(name, 60)} in a ring")
            depth[name] = -1
            if waiting:
                stack.extend(waiting)
                continue
            depth[name] = 1 + max((depth[n] for n in linked), default=0)
            stack.pop()
            if depth[name] > LONGEST_CHAIN:
                raise wrong(f"chains of at most {LONGEST_CHAIN} nodes", harmless(name, 60))
