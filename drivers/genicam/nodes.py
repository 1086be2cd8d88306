"""A camera's description: GenICam XML in, its nodes by name out (GenICam Standard 2.1, GenApi).

The text comes from the device and is not trusted: document types (and with them entities) are
refused, and sizes are limited.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.parsers import expat

from pipeline.errors import DriverError
from pipeline.text import harmless

MOST_BYTES = 16 << 20
MOST_NODES = 100_000
DEEPEST = 16  # elements within one another; the standard needs 5
LONGEST_TEXT = 1 << 16  # characters of one element

_GROUPS = ("RegisterDescription", "Group", "StructReg")


@dataclass(frozen=True, kw_only=True, eq=False)
class Node:
    """One element with a name: a feature, a register or a formula."""

    name: str
    kind: str  # the element: Integer, Enumeration, IntSwissKnife, MaskedIntReg …
    fields: tuple[tuple[str, str, str], ...]  # element, its Name (empty: none), its text
    entries: Mapping[str, int]  # value of each entry of an enumeration

    def text(self, field: str) -> str:
        """Text of the first element of this kind; empty: there is none."""
        return next((text for tag, _, text in self.fields if tag == field), "")

    def links(self, *kinds: str) -> Iterator[str]:
        """Names of the nodes that the elements of these kinds refer to."""
        # `Node.Min` refers to an aspect of a node
        return (text.partition(".")[0] for tag, _, text in self.fields if tag in kinds and text)


@dataclass(frozen=True, kw_only=True, eq=False)
class NodeMap:
    """All nodes of one camera."""

    vendor: str
    model: str
    nodes: Mapping[str, Node]

    def get(self, name: str) -> Node | None:
        """The node of this name; None: the camera has none."""
        return self.nodes.get(name)


def parse_nodes(xml: bytes) -> NodeMap:
    """Read a description; raises `DriverError` in one sentence where it is not one."""
    if len(xml) > MOST_BYTES:
        raise wrong(f"at most {MOST_BYTES >> 20} MB", f"{len(xml)} bytes")
    reader = _Reader()
    parser = expat.ParserCreate(namespace_separator="}")
    parser.buffer_text = True
    parser.StartElementHandler = reader.start
    parser.EndElementHandler = reader.end
    parser.CharacterDataHandler = reader.characters
    parser.StartDoctypeDeclHandler = _refuse_doctype
    try:
        parser.Parse(xml.rstrip(b"\0"), True)
    except expat.ExpatError as error:
        raise wrong("well-formed XML", harmless(str(error), 80)) from error
    except (LookupError, ValueError) as error:  # an encoding that it names and nobody knows
        raise wrong("a known encoding", harmless(str(error), 80)) from error
    if not reader.root:
        raise wrong("a RegisterDescription", "no element")
    return NodeMap(vendor=reader.vendor, model=reader.model, nodes=reader.nodes)


class _Reader:
    """Collects nodes while the parser goes through the text."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}
        self.root = self.vendor = self.model = ""
        self._path: list[str] = []
        self._text: list[str] = []
        self._open: list[tuple[int, str, list[tuple[str, str, str]], dict[str, int]]] = []
        self._entry = ""

    def start(self, qualified: str, attributes: dict[str, str]) -> None:
        tag = qualified.rpartition("}")[2]
        if not self._path:
            self._begin(tag, attributes)
        elif len(self._path) >= DEEPEST:
            raise wrong(f"at most {DEEPEST} levels", "more")
        elif self._path[-1] in _GROUPS and "Name" in attributes:
            self._open.append((len(self._path), attributes["Name"], [], {}))
        if tag == "EnumEntry":
            self._entry = attributes.get("Name", "")
        self._path.append(tag)
        self._text = [attributes.get("Name", "")]

    def characters(self, text: str) -> None:
        self._text.append(text)
        if sum(map(len, self._text[-64:])) > LONGEST_TEXT:
            raise wrong(f"texts of at most {LONGEST_TEXT} characters", "a longer one")

    def end(self, qualified: str) -> None:
        tag, name = self._path.pop(), self._text[0] if self._text else ""
        text, self._text = "".join(self._text[1:]).strip(), []
        if not self._open:
            return
        level, node, fields, entries = self._open[-1]
        depth = len(self._path)
        if depth == level:
            self._open.pop()
            self._keep(Node(name=node, kind=tag, fields=tuple(fields), entries=entries))
        elif depth == level + 1 or tag == "pVariable":  # of a formula within a register's address
            fields.append((tag, name, text))
        elif tag == "Value" and self._path[-1] == "EnumEntry":
            value = whole(text)
            if value is not None:
                entries[self._entry] = value

    def _begin(self, tag: str, attributes: dict[str, str]) -> None:
        if tag != "RegisterDescription":
            raise wrong("a RegisterDescription", f"<{harmless(tag, 40)}>")
        self.root = tag
        self.vendor = harmless(attributes.get("VendorName", ""), 80)
        self.model = harmless(attributes.get("ModelName", ""), 80)

    def _keep(self, node: Node) -> None:
        self.nodes[node.name] = node
        if len(self.nodes) > MOST_NODES:
            raise wrong(f"at most {MOST_NODES} nodes", "more")


def whole(text: str) -> int | None:
    """A number as descriptions write it; None where the text is none.

    >>> whole("0x10"), whole("-4"), whole("4.5")
    (16, -4, None)
    """
    try:
        return int(text[:40], 16 if text[:2].lower() == "0x" else 10)
    except ValueError:
        return None


def _refuse_doctype(*_arguments: object) -> None:
    raise wrong("no document type", "one")


def wrong(expected: str, got: str) -> DriverError:
    """The error of a description."""
    return DriverError(f"description of the camera: expected {expected}, got {got}")
