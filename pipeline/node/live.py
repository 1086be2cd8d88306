"""Change the live settings of a running operator, all or none of a request.

Changes are stored in a file, so that they survive a restart of the operator.
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
    """The settings of one running operator; used on the thread that calls its handlers."""

    def __init__(
        self, node: str, operator: Operator[Any, Any], values: Mapping[str, Any], file: Path | None
    ) -> None:
        self._node, self._operator, self._values = node, operator, dict(values)
        self._file = file

    def change(self, changes: Mapping[str, Any]) -> None:
        """Apply changed settings; raises `SettingsError` and changes nothing if refused."""
        kind = type(self._operator)
        cls, live = settings_of(kind), live_of(kind)
        values = {**self._values, **changes}
        fresh = checked.build(cls, values, self._node)  # unknown names are reported first
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
        except (OSError, RunError) as error:  # a change that a crash would undo is not made
            self._operator.on_settings(before)
            raise SettingsError(f"{self._node}: cannot be kept: {error}") from error
        self._values = values

    def describe(self) -> NodeSettings:
        """Return the current settings."""
        return NodeSettings(
            settings=checked.plain(self._operator.settings), live=live_of(type(self._operator))
        )

    def configure(self, question: ConfigQuestion) -> NodeSettings:
        """Apply the changes as `change` does, and return the current settings."""
        if question.changes:
            self.change(question.changes)
        return self.describe()


def keep(file: Path, values: Mapping[str, Any]) -> None:
    """Write values atomically: a killed process leaves the old or the new ones."""
    PrivateFolder(file.parent).write(file.name, json.dumps(dict(values)).encode())


def kept(file: Path) -> dict[str, Any]:
    """Return the values that a predecessor stored; empty if there are none."""
    try:
        return _KEPT.decode(PrivateFolder(file.parent).read(file.name, MOST_KEPT_BYTES))
    except FileNotFoundError:
        return {}
    except (OSError, FoveaError, msgspec.MsgspecError, ValueError, RecursionError) as error:
        log.warning("%s: cannot read the changed settings: %s", file, error)
        return {}
