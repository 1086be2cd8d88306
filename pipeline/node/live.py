"""Settings that change while an operator runs: a question of a few bytes in, an answer out.

A question is a msgpack map of setting to value, or empty: then nothing changes. The answer tells
every setting's effective value and which of them are live, or why the change was refused. What was
changed is kept in a file, so that an operator that dies comes back with it.
"""

import json
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from pipeline import codec
from pipeline import settings as checked
from pipeline.contract import Operator, live_of, settings_of
from pipeline.errors import FoveaError, RunError, SettingsError
from pipeline.private_folder import PrivateFolder
from pipeline.text import error_text, harmless

CONFIG = "@config"  # the key below a node's own that answers


class Answer(msgspec.Struct, forbid_unknown_fields=True):
    """What a node says of its settings."""

    settings: dict[str, Any] = {}
    live: tuple[str, ...] = ()
    refused: str = ""  # one sentence; empty when everything asked for holds now


_QUESTION = msgspec.msgpack.Decoder(dict[str, Any])
_ANSWER = msgspec.msgpack.Decoder(Answer)
_KEPT = msgspec.json.Decoder(dict[str, Any])
MOST_KEPT_BYTES = 1 << 20
log = logging.getLogger(__name__)


class Live:
    """The settings of one running operator; to be asked on the thread that calls its handlers."""

    def __init__(
        self, node: str, operator: Operator[Any, Any], values: Mapping[str, Any], file: Path | None
    ) -> None:
        self._node, self._operator, self._values = node, operator, dict(values)
        self._file = file

    def change(self, changes: Mapping[str, Any]) -> None:
        """Let the operator take over changed settings; raises `SettingsError` and leaves all."""
        kind = type(self._operator)
        cls, live = settings_of(kind), live_of(kind)
        values = {**self._values, **changes}
        fresh = checked.build(cls, values, self._node)  # an unknown name is told first
        for name in changes:
            if name not in live:
                raise SettingsError(
                    f"{self._node}.{name}: cannot change while the node runs; "
                    f"{', '.join(live) or 'none of its settings'} can"
                )
        before = self._operator.settings
        self._operator.on_settings(fresh)
        try:
            if self._file is not None:
                keep(self._file, {name: values[name] for name in live if name in values})
        except (OSError, RunError) as error:  # what a crash would undo is better not begun
            self._operator.on_settings(before)
            raise SettingsError(f"{self._node}: cannot be kept: {error}") from error
        self._values = values

    def describe(self, refused: str = "") -> Answer:
        """The effective values."""
        return Answer(
            settings=checked.plain(self._operator.settings),
            live=live_of(type(self._operator)),
            refused=refused,
        )

    def answer(self, question: bytes, reply: Callable[[bytes], None]) -> None:
        """Do what is asked and tell; an operator that breaks over it is told of, and raises."""
        refused = ""
        try:
            if question:
                self.change(read_question(question))
        except FoveaError as error:
            refused = harmless(str(error))
        except Exception as error:
            broken = f"{self._node}: it broke and starts again: {harmless(error_text(error))}"
            reply(msgspec.msgpack.encode(self.describe(broken)))
            raise
        reply(msgspec.msgpack.encode(self.describe(refused)))


def write_question(changes: Mapping[str, Any]) -> bytes:
    """The bytes that ask for changes; none ask only for the values."""
    return msgspec.msgpack.encode(dict(changes)) if changes else b""


def read_question(question: bytes) -> dict[str, Any]:
    """The changes asked for; raises `MessageError` for bytes that are none."""
    return codec.parse(_QUESTION.decode, question, "expected a msgpack map of setting to value")


def read_answer(answer: bytes) -> Answer:
    """What a node answered; raises `MessageError` for bytes that are none."""
    return codec.parse(_ANSWER.decode, answer, "not an answer about settings")


def keep(file: Path, values: Mapping[str, Any]) -> None:
    """Write values in one step: a process killed meanwhile leaves the old ones or the new."""
    PrivateFolder(file.parent).write(file.name, json.dumps(dict(values)).encode())


def kept(file: Path) -> dict[str, Any]:
    """What a predecessor kept, or nothing."""
    try:
        return _KEPT.decode(PrivateFolder(file.parent).read(file.name, MOST_KEPT_BYTES))
    except FileNotFoundError:
        return {}
    except (OSError, FoveaError, msgspec.MsgspecError, ValueError, RecursionError) as error:
        log.warning("%s: what was set before is not known: %s", file, error)
        return {}
