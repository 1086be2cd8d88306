"""Look for every kind of sensor at once: nothing in, what is attached out.

Each kind is looked for by a child process with a time limit, so that one that hangs or crashes
hides no other.
"""

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from drivers.attached.child import FAILED, FAMILY, Child
from drivers.attached.listing import KindFound
from pipeline.errors import DriverError, InstallError, SettingsError
from pipeline.settings import build

LIMIT_S = 10.0


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of sensor and the function that looks for it, which yields `AttachedSensor`s."""

    what: str
    look: str  # import path


KINDS: Mapping[str, Kind] = {
    "usb": Kind(what="dual-stream boards on USB", look="drivers.attached.boards:look"),
    "genicam": Kind(
        what="GigE Vision and USB3 Vision cameras", look="drivers.attached.industrial:look"
    ),
    "webcam": Kind(what="webcams", look="drivers.attached.webcams:look"),
}


def search(kinds: Mapping[str, Kind] = KINDS, *, limit_s: float = LIMIT_S) -> tuple[KindFound, ...]:
    """Return what was found of each kind, at most `limit_s` after all were started."""
    with ExitStack() as running:
        began_s = time.monotonic()
        children = {
            name: running.enter_context(Child(kind.look, limit_s=limit_s, in_all=True, quiet=True))
            for name, kind in kinds.items()
        }
        return tuple(
            _found(name, kinds[name].what, child, began_s) for name, child in children.items()
        )


def _found(name: str, what: str, child: Child, began_s: float) -> KindFound:
    """Collect what a child says; a sensor that was told before it failed is kept."""
    sensors: list[Any] = []
    told: dict[str, Any] = {}
    try:
        while (found := child.next()) is not None:
            if FAILED in found:
                missing = found[FAMILY] == InstallError.__name__
                told = {"missing" if missing else "problem": found[FAILED]}
            else:
                sensors.append(found)
    except DriverError as error:
        told = {"problem": str(error)}
    seconds = round(time.monotonic() - began_s, 3)
    values = {"kind": name, "what": what, "sensors": sensors, "seconds": seconds, **told}
    try:
        return build(KindFound, values, name)
    except SettingsError as error:
        return KindFound(kind=name, what=what, problem=str(error), seconds=seconds)
