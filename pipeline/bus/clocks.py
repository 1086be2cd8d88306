"""What the clocks of other hosts show: label -> offset and error, in a small file of the run.

Every time in a message's header is in the clock of the host that exposed it; the header names it.
The agent writes the file; the nodes of the run read it. One host alone needs none.
"""

import ctypes
import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.messages import Header
from pipeline.private_folder import PrivateFolder

ALONE = "monotonic"  # what a header says where there is one host only
MOST_HOSTS = 64


class Reading(ctypes.Structure):
    """How far another clock is ahead of this host's."""

    offset_ns: int
    error_ns: int  # the true offset lies within this of the other; 0: not known yet

    _fields_ = [("offset_ns", ctypes.c_int64), ("error_ns", ctypes.c_uint64)]


@dataclass(frozen=True)
class Clocks:
    """The clocks of all hosts as one of them sees them."""

    own: str = ALONE
    readings: Mapping[str, Reading] = field(default_factory=dict)

    @staticmethod
    def create(path: Path, own: str, hosts: tuple[str, ...]) -> "Clocks":
        """Make the file, with nothing known."""
        PrivateFolder(path.parent).write(path.name, bytes(MOST_HOSTS * ctypes.sizeof(Reading)))
        return Clocks.open(path, own, hosts)

    @staticmethod
    def open(path: Path, own: str, hosts: tuple[str, ...]) -> "Clocks":
        """Map the file; hosts in the order of the graph."""
        with os.fdopen(PrivateFolder(path.parent).open(path.name, writable=True), "r+b") as file:
            memory = mmap.mmap(file.fileno(), 0)
        size = ctypes.sizeof(Reading)
        return Clocks(
            own, {host: Reading.from_buffer(memory, i * size) for i, host in enumerate(hosts)}
        )

    def ahead_ns(self, clock: str) -> int | None:
        """What to add to this host's time to get the time of that clock; None: not known."""
        if clock in (self.own, ALONE):
            return 0
        reading = self.readings.get(clock)
        return reading.offset_ns if reading is not None and reading.error_ns else None

    def error_ns(self, clock: str) -> int | None:
        """By how much that may be wrong; None: not known."""
        if clock in (self.own, ALONE):
            return 0
        reading = self.readings.get(clock)
        return reading.error_ns or None if reading is not None else None

    def age_ns(self, header: Header, now_ns: int) -> int | None:
        """How old an exposure is; None while its clock is not known."""
        ahead = self.ahead_ns(header.clock)
        return None if ahead is None else now_ns + ahead - header.stamp_ns
