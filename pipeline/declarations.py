"""Check the declarations of an operator class against the contract before it is used.

A user's class may declare anything: inputs without a message type, settings that cannot be parsed,
commands without a method, methods that cannot be called as the runtime calls them. Every loader of
operators uses these checks, so that each mistake has one error message.
"""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from typing import Any, get_args

from pipeline import settings as checked
from pipeline.cause import cause_of, is_signal
from pipeline.class_cache import cached_by_class
from pipeline.commands import commands_of
from pipeline.contract import (
    Input,
    Keep,
    Operator,
    handlers_of,
    inputs_of,
    live_of,
    outputs_of,
    settings_of,
)
from pipeline.errors import FoveaError, GraphError
from pipeline.graph.limits import EDGE, check_numbers
from pipeline.messages import Message
from pipeline.naming import check_name
from pipeline.wording import shown

FLAGS = ("join", "optional", "command", "tap")
CALLED = ("open", "close", "on_stream", "on_settings", "state", "restore", "summary", "produce")


@cached_by_class
def check_declarations(operator: type[Operator[Any, Any]]) -> None:
    """Raise `GraphError` for a class whose declarations violate the contract."""
    where = f"{operator.__module__}:{operator.__qualname__}"
    try:
        _check_settings(operator, where)
        for name, port in inputs_of(operator).items():
            _check_input(name, port, where)
        for name, message in outputs_of(operator).items():
            check_name(name, f"{where}: an output's name")
            _check_message(message, f"{where}.{name}")
        for name in ("live", "commands"):
            _check_names(getattr(operator, name), f"{where}.{name}")
        live_of(operator)
        commands_of(operator)
        _check_methods(operator, where)
    except FoveaError as error:
        raise GraphError(str(error)) from error
    except Exception as error:
        if is_signal(error):
            raise
        raise GraphError(f"{where}: its declarations cannot be read: {cause_of(error)}") from error


def _check_settings(operator: type[Operator[Any, Any]], where: str) -> None:
    settings = settings_of(operator)
    if not is_dataclass(settings):
        raise GraphError(f"{where}: expected a dataclass of settings, got {shown(settings)}")
    try:
        checked.check_type(settings)
    except Exception as error:
        if is_signal(error):
            raise
        what = f"{where}: its settings {settings.__qualname__} cannot be read"
        raise GraphError(f"{what}: {cause_of(error)}") from error


def _check_input(name: str, port: Input, where: str) -> None:
    place = f"{where}.{name}"
    check_name(name, f"{where}: an input's name")
    _check_message(port.message, place)
    allowed = {"keep": get_args(Keep), "stale": ("drop", "pass")}
    allowed |= dict.fromkeys(FLAGS, (True, False))
    for attribute, values in allowed.items():
        value = getattr(port, attribute)
        if not any(value is v or (isinstance(v, str) and value == v) for v in values):
            expected = " or ".join(map(str, values))
            raise GraphError(f"{place}.{attribute}: expected {expected}, got {shown(value)}")
    check_numbers(port, EDGE, place)


def _check_message(message: object, place: str) -> None:
    if not (isinstance(message, type) and issubclass(message, Message)):
        raise GraphError(f"{place}: expected a type of message, got {shown(message)}")


def _check_names(names: object, place: str) -> None:
    if not isinstance(names, (tuple, list)) or not all(isinstance(n, str) for n in names):
        raise GraphError(f"{place}: expected a tuple of names, got {shown(names)}")


def _check_methods(operator: type[Operator[Any, Any]], where: str) -> None:
    """Raise `GraphError` for a method that cannot be called as the runtime calls it.

    Whether there is a handler is checked where the inputs are connected.
    """
    _check_arguments(operator, "__init__", ("settings",), where)
    handlers = handlers_of(operator)
    for name, inputs in handlers.items():
        _check_arguments(operator, name, inputs, where, by_name=True)
    for name in (*handlers, *CALLED, *(f"do_{command}" for command in operator.commands)):
        method = getattr(operator, name, None)
        if inspect.iscoroutinefunction(method) or inspect.isasyncgenfunction(method):
            raise GraphError(f"{where}.{name}: expected def, got async def")


def _check_arguments(
    operator: type[Any], name: str, wanted: Sequence[str], where: str, *, by_name: bool = False
) -> None:
    """Raise `GraphError` unless a method takes these arguments; what has no signature is let by."""
    known = _signature(inspect.getattr_static(operator, name, None), operator)
    if known is None:
        return
    try:
        known.bind(**dict.fromkeys(wanted)) if by_name else known.bind(*wanted)
    except TypeError as error:
        expected, got = (", ".join(names) or "none" for names in (wanted, known.parameters))
        place = f"{where}.{name}: expected the arguments"
        raise GraphError(f"{place} {expected}, got {got}") from error


def _signature(method: Any, operator: type[Any]) -> inspect.Signature | None:
    """Return what a method of an instance takes behind `self`; None where it cannot be known."""
    bind: Callable[..., Any] | None = getattr(method, "__get__", None)
    try:  # not that of what it wraps: a wrapper is called with its own arguments
        bound = bind(object(), operator) if bind else method
        return inspect.signature(bound, follow_wrapped=False)
    except Exception:  # a property, a function of C, or whatever a descriptor does
        return None
