"""Failures of a virtual board, by script: at which exposure what goes wrong."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from pipeline.errors import SettingsError
from pipeline.settings import build

Kind = Literal[
    "unplug",  # gone for `seconds`; then enumerated anew, and idle
    "stall",  # the end point of `stream` halts in the middle of the payload
    "truncate",  # the payload ends early
    "corrupt_header",  # a bit of the header is wrong
    "corrupt_payload",  # a bit of the pixels is wrong
    "overflow",  # the board sends more than is asked for; the rest of the frame is lost
    "silence",  # nothing is exposed for `seconds`
    "broken",  # the sensor fails: nothing is exposed until START
    "skip",  # the frame of `stream` is not sent
]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One failure."""

    kind: Kind
    exposure: int  # since START
    stream: Literal["context", "roi"] = "roi"
    seconds: float = 0.1

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise SettingsError(f"kind: expected {', '.join(get_args(Kind))}, got {self.kind}")
        if self.exposure < 0 or not 0 <= self.seconds <= 3600:
            raise SettingsError(
                f"fault: expected exposure >= 0 and seconds of 0 to 3600, got {self}"
            )


def faults_of(given: Iterable[Mapping[str, Any]]) -> list[Fault]:
    """Return the faults of a graph's option; raises `SettingsError`."""
    return [build(Fault, one, f"faults[{k}]") for k, one in enumerate(given)]


class FaultScript:
    """The failures that are still to come; each happens once."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._coming = list(faults)
        self.happened: list[Fault] = []

    def add(self, fault: Fault) -> None:
        """Add a failure, also while the board runs."""
        self._coming.append(fault)

    def due(self, kind: Kind, exposure: int, stream: str = "") -> Fault | None:
        """Return the failure of this kind that is due at the exposure, once."""
        for fault in self._coming:
            if fault.kind == kind and fault.exposure <= exposure and stream in ("", fault.stream):
                self._coming.remove(fault)
                self.happened.append(fault)
                return fault
        return None
