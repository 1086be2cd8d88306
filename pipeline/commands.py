"""Deeds that an operator does when told to: a command and its arguments in, an answer out.

An operator names them in `commands`; each is a method `do_<command>` whose arguments have names,
types and maybe defaults, and which answers with plain values or with nothing. It is called between
two calls of handlers, by the same thread.
"""

import dataclasses
import inspect
import json
import typing
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from pipeline import codec
from pipeline import settings as checked
from pipeline.contract import Operator
from pipeline.errors import FoveaError, SettingsError
from pipeline.text import error_text, harmless

COMMAND = "@command"  # the key below a node's own that does and answers


class Order(msgspec.Struct, forbid_unknown_fields=True):
    """What a node is told to do."""

    command: str
    arguments: dict[str, Any] = {}


class Outcome(msgspec.Struct, forbid_unknown_fields=True):
    """What became of it."""

    answer: dict[str, Any] = {}
    refused: str = ""  # one sentence; empty when it was done


_ORDER = msgspec.msgpack.Decoder(Order)
_OUTCOME = msgspec.msgpack.Decoder(Outcome)


def commands_of(operator: type[Operator[Any, Any]]) -> dict[str, type[Any]]:
    """A dataclass of arguments for every command; raises `SettingsError` for what is none."""
    return {name: _arguments(operator, name) for name in operator.commands}


def carry_out(node: str, operator: Operator[Any, Any], order: bytes) -> Outcome:
    """Do what is ordered; what is refused changed nothing.

    An exception that is no `FoveaError` passes through: the operator broke.
    """
    try:
        told = read_order(order, node)
        arguments = read_arguments(type(operator), told, node)
        given = getattr(operator, f"do_{told.command}")(**arguments)
    except FoveaError as error:
        return Outcome(refused=harmless(str(error)))
    plain: dict[str, Any] = json.loads(json.dumps(dict(given or {})))
    return Outcome(answer=plain)


def obey(
    node: str, operator: Operator[Any, Any], order: bytes, reply: Callable[[bytes], None]
) -> None:
    """Do it and tell; an operator that breaks over it is told of, and raises."""
    try:
        outcome = carry_out(node, operator, order)
    except Exception as error:
        broken = f"{node}: it broke and starts again: {harmless(error_text(error))}"
        reply(write_outcome(Outcome(refused=broken)))
        raise
    reply(write_outcome(outcome))


def read_arguments(cls: type[Operator[Any, Any]], order: Order, node: str) -> dict[str, Any]:
    """The arguments as the operator's method wants them; raises `SettingsError`."""
    known = commands_of(cls)
    if order.command not in known:
        hint = checked.suggest(order.command, known)
        raise SettingsError(f"{node}: no command {order.command}{hint}")
    built = checked.build(known[order.command], order.arguments, f"{node}.{order.command}")
    return {f.name: getattr(built, f.name) for f in dataclasses.fields(built)}


def write_order(command: str, arguments: Mapping[str, Any]) -> bytes:
    """The bytes that tell a node what to do; raises `MessageError` for what cannot travel."""
    return codec.to_bytes(Order(command, dict(arguments)))


def read_order(order: bytes, node: str) -> Order:
    """What a node is told to do; raises `MessageError` for bytes that do not say."""
    return codec.parse(_ORDER.decode, order, f"{node}: not an order")


def write_outcome(outcome: Outcome) -> bytes:
    """The bytes that tell what became of it."""
    return msgspec.msgpack.encode(outcome)


def read_outcome(answer: bytes) -> Outcome:
    """What became of an order; raises `MessageError` for bytes that do not say."""
    return codec.parse(_OUTCOME.decode, answer, "not an answer to a command")


def _arguments(operator: type[Operator[Any, Any]], name: str) -> type[Any]:
    where = f"{operator.__module__}:{operator.__qualname__}.commands"
    method = getattr(operator, f"do_{name}", None)
    if not callable(method):
        raise SettingsError(f"{where}: expected a method do_{name}, got none")
    hints = typing.get_type_hints(method)
    fields: list[Any] = []
    for parameter in list(inspect.signature(method).parameters.values())[1:]:
        if parameter.name not in hints:
            raise SettingsError(f"{where}: do_{name}({parameter.name}): expected a type, got none")
        field: tuple[Any, ...] = (parameter.name, hints[parameter.name])
        if parameter.default is not parameter.empty:
            field = (*field, dataclasses.field(default=parameter.default))
        fields.append(field)
    return dataclasses.make_dataclass(name, fields, frozen=True, kw_only=True)
