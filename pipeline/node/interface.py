"""Interface of a node for `@schema`: settings, commands, ports and their fingerprints."""

from typing import Any

from pipeline import codec
from pipeline import settings as checked
from pipeline.commands import commands_of
from pipeline.contract import Operator, inputs_of, live_of, outputs_of, settings_of
from pipeline.protocol.questions import Interface, Port


def interface(node: str, cls: type[Operator[Any, Any]]) -> Interface:
    """Return the interface of an operator."""
    return Interface(
        node=node,
        operator=f"{cls.__module__}:{cls.__qualname__}",
        settings=checked.json_schema(settings_of(cls)),
        live=live_of(cls),
        commands={name: checked.json_schema(a) for name, a in commands_of(cls).items()},
        inputs={n: _port(i.message, i.keep) for n, i in inputs_of(cls).items()},
        outputs={n: _port(message) for n, message in outputs_of(cls).items()},
    )


def _port(message: type[Any], keep: str = "") -> Port:
    known = codec.schema(message)
    return Port(message.__name__, known.fingerprint.hex(), keep, known.text)
