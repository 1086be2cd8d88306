"""What a swap carries over of an operator's state, and what it loses.

An operator that declares `state()` says itself what has to survive. For one that does not, its
attributes are compared with what `open` left: what `open` alone rebuilds, such as a model, is
unchanged.
"""

import dataclasses
import sys
import types
import typing
import zlib
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Union

import numpy as np

from pipeline import codec
from pipeline.contract import Operator
from pipeline.errors import MessageError, RunError
from pipeline.text import error_text

DEEPEST = 4  # containers and objects within one another
MOST_ITEMS = 5000  # looked at in one attribute
MOST_BYTES = 1 << 20  # of an array whose values are compared; a bigger one counts by identity
_OWN = frozenset(vars(Operator(None)))  # what the base class sets
_PLAIN = (bool, int, float, complex, str, bytes, type(None))


def restore(operator: Operator[Any, Any], data: bytes, *, must: bool = False) -> str:
    """Let an operator take over another's state; `begins anew` when it is not of its kind.

    Raises `RunError` when the operator itself fails over it, and for what is not of its kind where
    it `must` be: between two instances of one class.
    """
    cls = type(operator)
    try:
        kind = state_type(cls)
        if kind is None:
            raise MessageError("its state() names no dataclass as what it returns")
        if cls.restore is Operator.restore:
            raise MessageError("it declares state() and no restore()")
        state = codec.loads(kind, data)
    except MessageError as error:
        if must:
            raise RunError(f"the state cannot be carried over: {error}") from error
        return f"begins anew: {error}"
    try:
        operator.restore(state)
    except Exception as error:
        raise RunError(f"its restore() failed: {error_text(error)}") from error
    return "carried over"


def class_of(operator: Operator[Any, Any]) -> str:
    """The import path of an operator's class."""
    return f"{type(operator).__module__}:{type(operator).__qualname__}"


def lost_words(attributes: Sequence[str]) -> str:
    """What a successor begins without, in a sentence."""
    return (
        f"begins without what its predecessor kept in {', '.join(attributes)}; what has to survive "
        "is to be given by state() and taken over by restore()"
    )


def state_type(operator: type[Operator[Any, Any]]) -> type[Any] | None:
    """The dataclass that `state` promises to return; None when it promises none."""
    try:
        hint = typing.get_type_hints(operator.state).get("return")
    except (NameError, TypeError):  # a name that is only there for a type checker
        return None
    union = typing.get_origin(hint) in (Union, types.UnionType)
    options = typing.get_args(hint) if union else (hint,)
    found = [o for o in options if isinstance(o, type) and dataclasses.is_dataclass(o)]
    return found[0] if len(found) == 1 else None


class UndeclaredState:
    """Made when the operator has been opened. It keeps numbers only, none of the values."""

    def __init__(self, operator: Operator[Any, Any]) -> None:
        self._operator = operator
        self._declared = type(operator).state is not Operator.state
        self._opened = {} if self._declared else _digests(operator)

    def names(self) -> list[str]:
        """The attributes that changed since, sorted; none of an operator that declares its state.

        >>> from pipeline import Operator
        >>> operator = Operator(None)
        >>> operator.model, operator.seen = object(), []
        >>> before = UndeclaredState(operator)
        >>> operator.seen.append(7); operator.last = 7
        >>> before.names()
        ['last', 'seen']
        """
        if self._declared:
            return []
        now = _digests(self._operator)
        return sorted(n for n, digest in now.items() if self._opened.get(n) != digest)


def _digests(operator: Operator[Any, Any]) -> dict[str, int]:
    """A number for the value of every attribute of the operator's own."""
    return {n: _Look().of(v) for n, v in vars(operator).items() if n not in _OWN}


class _Look:
    """One look at a value, within bounds."""

    def __init__(self) -> None:
        self._left = MOST_ITEMS

    def of(self, value: Any, depth: int = 0) -> int:
        """A number that is another one for another value."""
        self._left -= 1
        if isinstance(value, (*_PLAIN, np.generic)):
            return hash((type(value).__name__, repr(value)))
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            same = (value.shape, value.dtype.str)
            small = value.nbytes <= MOST_BYTES
            return hash((*same, zlib.crc32(value.tobytes()) if small else id(value)))
        if depth >= DEEPEST or self._left <= 0:
            return id(value)
        return self._of_many(value, depth + 1)

    def _of_many(self, value: Any, depth: int) -> int:
        if isinstance(value, Mapping):
            items = [(self.of(k, depth), self.of(v, depth)) for k, v in self._some(value.items())]
            return hash((len(value), *items))
        if isinstance(value, (list, tuple, deque)):
            return hash((len(value), *(self.of(v, depth) for v in self._some(value))))
        if isinstance(value, (set, frozenset)):
            return hash((len(value), frozenset(self.of(v, depth) for v in self._some(value))))
        package = type(value).__module__.partition(".")[0]
        inside = getattr(value, "__dict__", None)
        if not isinstance(inside, dict) or package in sys.stdlib_module_names:
            return id(value)
        items = [(n, self.of(v, depth)) for n, v in self._some(inside.items())]
        return hash((type(value).__qualname__, *items))

    def _some(self, items: Any) -> list[Any]:
        """As many items as may still be looked at."""
        return [item for item, _ in zip(items, range(max(0, self._left)), strict=False)]
