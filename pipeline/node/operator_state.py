"""What a swap carries over of an operator's state, and what it loses.

An operator that declares `state()` says itself what has to survive. For one that does not, its
attributes (and those of its class) are compared with what `open` left: what `open` alone rebuilds,
such as a model, is unchanged.
"""

import dataclasses
import types
import typing
from collections.abc import Sequence
from typing import Any, Union

from pipeline import codec
from pipeline.contract import Input, Operator, Output
from pipeline.errors import MessageError, RunError
from pipeline.node.fingerprint import Fingerprint
from pipeline.text import error_text

OPAQUE = " (cannot be looked into)"  # behind the name of an attribute
_OWN = frozenset(vars(Operator(None)))  # what the base class sets


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
    """What a successor begins without, in a sentence.

    >>> print(lost_words(["seen", f"filter{OPAQUE}"]).partition(";")[0])
    begins without what its predecessor kept in seen, and perhaps in filter (cannot be looked into)
    """
    known = [a for a in attributes if not a.endswith(OPAQUE)]
    opaque = [a for a in attributes if a.endswith(OPAQUE)]
    where = f"in {', '.join(known)}" if known else ""
    if opaque:
        where += f"{', and ' if known else ''}perhaps in {', '.join(opaque)}"
    return (
        f"begins without what its predecessor kept {where}; what has to survive "
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
        self._opened = {} if self._declared else _looked(operator)

    def names(self) -> list[str]:
        """The attributes that changed since, sorted; none of an operator that declares its state.

        One that nobody can look into, and that is the same object still, is named as that.

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
        found = []
        for name, (value, opaque) in _looked(self._operator).items():
            if name not in self._opened or self._opened[name][0] != value:
                found.append(name)
            elif opaque:
                found.append(f"{name}{OPAQUE}")
        return sorted(found)


def _looked(operator: Operator[Any, Any]) -> dict[str, tuple[int, bool]]:
    """A number for every attribute, also of the class, and whether it is opaque."""
    found = {}
    for name, value in {**_of_classes(type(operator)), **vars(operator)}.items():
        if name not in _OWN:
            look = Fingerprint()
            found[name] = look.of(value), look.opaque
    return found


def _of_classes(cls: type[Operator[Any, Any]]) -> dict[str, Any]:
    """What its classes keep for all instances: no functions, ports or names of Python's own."""
    found: dict[str, Any] = {}
    for base in reversed(cls.__mro__[: cls.__mro__.index(Operator)]):
        found |= {
            name: value
            for name, value in vars(base).items()
            if not (name.startswith("__") or hasattr(value, "__get__"))
            and not isinstance(value, (Input, Output))
        }
    return found
