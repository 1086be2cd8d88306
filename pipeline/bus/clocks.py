"""Clock offsets between hosts: label -> offset and error, in a small file of the run.

All times of a header are in the clock of the exposing host, which the header names. The agent
writes the file, the nodes of the run read it. A graph on a single host has no such file.
"""

import ctypes
import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.messages import Header
from pipeline.private_folder import PrivateFolder

ALONE = "monotonic"  # label of the clock where there is only one host
MOST_HOSTS = 64


class Reading(ctypes.Structure):
    """Offset of another clock relative to this host's."""

    offset_ns: int
    error_ns: int  # maximum error of the offset; 0: not known yet

    _fields_ = [("offset_ns", ctypes.c_int64), ("error_ns", ctypes.c_uint64)]


@dataclass(frozen=True)
class Clocks:
    """The clocks of all hosts relative to the clock of one host."""

    own: str = ALONE
    readings: Mapping[str, Reading] = field(default_factory=dict)

    @staticmethod
    def create(path: Path, own: str, hosts: tuple[str, ...]) -> "Clocks":
        """Create the file, with every offset unknown."""
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
        """Return the offset to add to this host's time to get that clock's; None: not known."""
        if clock in (self.own, ALONE):
            return 0
        reading = self.readings.get(clock)
        return reading.offset_ns if reading is not None and reading.error_ns else None

    def error_ns(self, clock: str) -> int | None:
        """Return the maximum error of the offset; None: not known."""
        if clock in (self.own, ALONE):
            return 0
        reading = self.readings.get(clock)
        return reading.error_ns or None if reading is not None else None

    def age_ns(self, header: Header, now_ns: int) -> int | None:
        """Return the age of an exposure; None while its clock is not known."""
        ahead = self.ahead_ns(header.clock)
        return None if ahead is None else now_ns + ahead - header.stamp_ns
