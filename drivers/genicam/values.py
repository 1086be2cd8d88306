"""Values of a camera's features without the camera: a node map in, numbers or "not known" out.

What a description states as constants and formulas is known from the text alone. Registers are
known only to the camera: `read` asks it, where it is connected, by the name of the register's node.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.genicam.formula import Number, Values, compute
from drivers.genicam.nodes import Node, NodeMap, whole

REGISTERS = ("IntReg", "MaskedIntReg", "FloatReg", "StructEntry")
FORMULAS = ("SwissKnife", "IntSwissKnife")
DEEPEST = 32  # nodes and expressions that need one another; what lies deeper is not known


def unknown(_register: str) -> None:
    """No camera is connected: no register is known."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Range of a feature; None: told by the camera itself."""

    low: Number | None
    high: Number | None
    step: Number | None


class NodeValues:
    """Values of one node map; `given` are those that differ from what the text states."""

    def __init__(
        self, found: NodeMap, *, read: Values = unknown, given: Mapping[str, Number] | None = None
    ) -> None:
        self._found, self._read = found, read
        self._known: dict[str, Number | None] = dict(given or {})

    def value(self, name: str, depth: int = 0) -> Number | None:
        """The value of a node; None: not known."""
        if name not in self._known:
            node = self._found.get(name)
            known = node is not None and depth <= DEEPEST
            self._known[name] = self._computed(node, depth) if node and known else None
        return self._known[name]

    def limits(self, name: str) -> Limits:
        """Lowest and highest value and the step; where the text has no step it is 1."""
        node = self._found.get(name)
        if node is None:
            return Limits(low=None, high=None, step=None)
        step = self._limit(node, "Inc", "pInc")
        bare = not (node.text("Inc") or node.text("pInc"))
        return Limits(
            low=self._limit(node, "Min", "pMin"),
            high=self._limit(node, "Max", "pMax"),
            step=1 if bare else step,
        )

    def there(self, name: str) -> bool:
        """Whether a feature exists and is not stated to be missing."""
        node = self._found.get(name)
        if node is None:
            return False
        states = [self.value(n) for n in node.links("pIsImplemented", "pIsAvailable")]
        return all(state is None or state for state in states)

    def locked(self, name: str) -> bool | None:
        """Whether a feature cannot be written; None: the camera alone knows."""
        node = self._found.get(name)
        if node is None or node.text("ImposedAccessMode") == "RO":
            return True
        state: bool | None = False
        for link in node.links("pIsLocked"):
            found = self.value(link)
            state = None if found is None else bool(found)
        if state is False and self._read_only(node):
            return True
        return state

    def _read_only(self, node: Node) -> bool:
        for link in node.links("pValue"):
            behind = self._found.get(link)
            if behind is not None and behind.kind in REGISTERS:
                return behind.text("AccessMode") == "RO"
        return False

    def _limit(self, node: Node, stated: str, link: str) -> Number | None:
        if node.text(stated):
            return _number(node.text(stated))
        for name in node.links(link):
            return self.value(name)
        return None

    def _computed(self, node: Node, depth: int) -> Number | None:
        if node.kind in REGISTERS:
            return self._read(node.name)
        if node.kind in FORMULAS:
            return self._formula(node, depth)
        if node.text("Value"):
            return _number(node.text("Value"))
        for link in node.links("pValue"):
            return self.value(link, depth + 1)
        return None

    def _formula(self, node: Node, depth: int) -> Number | None:
        places = {name: text for tag, name, text in node.fields if tag == "pVariable"}
        parts = {name: text for tag, name, text in node.fields if tag == "Expression"}
        stated = {name: text for tag, name, text in node.fields if tag == "Constant"}
        level, known = depth, dict[str, Number | None]()

        def named(name: str) -> Number | None:
            nonlocal level
            if name in stated:
                return _number(stated[name])
            if name in known:
                return known[name]  # computed once, however often the text has it
            known[name] = None  # where it takes its value from itself, it is not known
            level += 1
            if name in parts and level <= DEEPEST:
                known[name] = compute(parts[name], named)
            elif name in places:
                known[name] = self.value(places[name].removesuffix(".Value"), level)
            level -= 1
            return known[name]

        return compute(node.text("Formula"), named)


def _number(text: str) -> Number | None:
    found = whole(text)
    if found is not None:
        return found
    try:
        return float(text[:40])
    except ValueError:
        return None
