"""What a node answers to `@schema`: its settings, commands, and ports with their fingerprints."""

from typing import Any

import msgspec

from pipeline import codec
from pipeline import settings as checked
from pipeline.commands import commands_of
from pipeline.contract import Operator, inputs_of, live_of, outputs_of, settings_of

SCHEMA = "@schema"  # the key below a node's own that answers


class Port(msgspec.Struct, forbid_unknown_fields=True):
    """An input or an output."""

    message: str
    fingerprint: str  # of the message's fields, types and shapes
    keep: str = ""  # of an input


class Interface(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """What a node takes and gives, and how it can be set and told."""

    node: str
    operator: str
    settings: dict[str, Any]  # JSON Schema
    live: tuple[str, ...]
    commands: dict[str, dict[str, Any]]  # JSON Schema of the arguments
    inputs: dict[str, Port]
    outputs: dict[str, Port]


_INTERFACE = msgspec.msgpack.Decoder(Interface)


def interface(node: str, cls: type[Operator[Any, Any]]) -> Interface:
    """The interface of an operator."""
    return Interface(
        node=node,
        operator=f"{cls.__module__}:{cls.__qualname__}",
        settings=checked.json_schema(settings_of(cls)),
        live=live_of(cls),
        commands={name: checked.json_schema(a) for name, a in commands_of(cls).items()},
        inputs={n: _port(i.message, i.keep) for n, i in inputs_of(cls).items()},
        outputs={n: _port(message) for n, message in outputs_of(cls).items()},
    )


def write_interface(found: Interface) -> bytes:
    """The bytes of the answer."""
    return msgspec.msgpack.encode(found)


def read_interface(answer: bytes) -> Interface:
    """What a node answered; raises `MessageError` for bytes that are none."""
    return codec.parse(_INTERFACE.decode, answer, "not an answer about a node's interface")


def _port(message: type[Any], keep: str = "") -> Port:
    return Port(message.__name__, codec.fingerprint(message).hex(), keep)
