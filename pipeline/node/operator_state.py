"""State of an operator that a swap transfers, and state that it loses.

An operator declares by `state()` what has to survive. Without `state()`, its attributes (and those
of its class) are compared with their values after `open`: an unchanged attribute, such as a model,
is rebuilt by `open`.
"""

import dataclasses
import types
import typing
from collections.abc import Sequence
from typing import Any, Union

from pipeline import codec
from pipeline.cause import cause_of
from pipeline.contract import Input, Operator, Output
from pipeline.errors import MessageError, RunError
from pipeline.node.fingerprint import Fingerprint

WITHOUT = "; `fovea swap --fresh` begins without it"
OPAQUE = " (cannot be looked into)"  # appended to the name of an attribute
_OWN = frozenset(vars(Operator(None)))  # attributes of the base class


def restore(operator: Operator[Any, Any], data: bytes, *, must: bool = False) -> str:
    """Restore another instance's state; return `begins anew` if its type differs.

    Raises `RunError` when `restore` itself fails, and for another type if `must`, i.e. between two
    instances of one class.
    """
    try:
        state = _loaded(type(operator), data)
    except MessageError as error:
        if must:
            raise RunError(f"the state cannot be carried over: {error}{WITHOUT}") from error
        return f"begins anew: {error}"
    try:
        operator.restore(state)
    except Exception as error:
        raise RunError(f"its restore() failed: {cause_of(error)}{WITHOUT}") from error
    return "carried over"


def check_state(node: str, operator: Operator[Any, Any]) -> None:
    """Raise `RunError`, beginning with `node`, for a state that a swap could not carry over."""
    if (state := operator.state()) is None:
        return
    try:
        _loaded(type(operator), codec.dumps(state))
    except MessageError as error:
        raise RunError(f"{node}: a swap cannot carry its state over: {error}") from error


def _loaded(cls: type[Operator[Any, Any]], data: bytes) -> Any:
    """Return a state of this class; raises `MessageError` for one that it does not declare."""
    if cls.state is Operator.state:
        raise MessageError("it has no state()")
    kind = state_type(cls)
    if kind is None:
        raise MessageError("its state() names no dataclass as what it returns")
    if cls.restore is Operator.restore:
        raise MessageError("it declares state() and no restore()")
    if data[:8] != codec.fingerprint(kind):
        raise MessageError(f"{kind.__name__} has other fields than before")
    return codec.loads(kind, data)


def class_of(operator: Operator[Any, Any]) -> str:
    """Return the import path of an operator's class."""
    return f"{type(operator).__module__}:{type(operator).__qualname__}"


def lost_words(attributes: Sequence[str]) -> str:
    """Describe the state that a successor lacks.

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
    """Return the dataclass in the return annotation of `state`; None if there is none."""
    try:
        hint = typing.get_type_hints(operator.state).get("return")
    except (NameError, TypeError):  # a name that exists only for type checkers
        return None
    union = typing.get_origin(hint) in (Union, types.UnionType)
    options = typing.get_args(hint) if union else (hint,)
    found = [o for o in options if isinstance(o, type) and dataclasses.is_dataclass(o)]
    return found[0] if len(found) == 1 else None


class UndeclaredState:
    """Fingerprints of an operator's attributes, taken after `open`; holds no values."""

    def __init__(self, operator: Operator[Any, Any]) -> None:
        self._operator = operator
        self._declared = type(operator).state is not Operator.state
        self._opened = {} if self._declared else _looked(operator)

    def names(self) -> list[str]:
        """Return the attributes that changed since, sorted; none if the operator has `state`.

        An unchanged object that cannot be inspected is marked as such.

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
    """Return a fingerprint of every attribute, also of the class, and whether it is opaque."""
    found = {}
    for name, value in {**_of_classes(type(operator)), **vars(operator)}.items():
        if name not in _OWN:
            look = Fingerprint()
            try:
                found[name] = look.of(value), look.opaque
            except Exception:  # its class may do anything, and another thread may change it
                found[name] = id(value), True
    return found


def _of_classes(cls: type[Operator[Any, Any]]) -> dict[str, Any]:
    """Return data attributes of its classes: no functions, ports or dunder names."""
    found: dict[str, Any] = {}
    for base in reversed(cls.__mro__[: cls.__mro__.index(Operator)]):
        found |= {
            name: value
            for name, value in vars(base).items()
            if not (name.startswith("__") or hasattr(value, "__get__"))
            and not isinstance(value, (Input, Output))
        }
    return found
