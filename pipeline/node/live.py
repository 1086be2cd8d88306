"""Settings that change while an operator runs, all of a question or none of it.

What was changed is kept in a file, so that an operator that dies comes back with it.
"""

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from pipeline import settings as checked
from pipeline.contract import Operator, live_of, settings_of
from pipeline.errors import FoveaError, RunError, SettingsError
from pipeline.private_folder import PrivateFolder
from pipeline.protocol.questions import ConfigQuestion, NodeSettings

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

    def describe(self) -> NodeSettings:
        """The effective values."""
        return NodeSettings(
            settings=checked.plain(self._operator.settings), live=live_of(type(self._operator))
        )

    def configure(self, question: ConfigQuestion) -> NodeSettings:
        """Change what is asked for, as `change` does; the effective values."""
        if question.changes:
            self.change(question.changes)
        return self.describe()


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
