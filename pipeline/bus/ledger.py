"""The accounts of a graph in shared memory: who was offered what, and what became of it.

One file holds a page per edge and a page per node. Every counter has a single writer, so no lock is
needed, and nothing is lost when a process is killed: its successor goes on from the same numbers.

    offered = delivered + dropped + in flight + lost in a crash
"""

import ctypes
import mmap
import os
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.bus.histogram import BUCKETS, Histogram
from pipeline.errors import RunError
from pipeline.private_folder import PrivateFolder

FILE = "ledger"  # in the memory folder of the run
PAGE_BYTES = 4096
EDGE_BYTES = 2 * PAGE_BYTES  # counters, then the histogram of ages
NODE_BYTES = 6 * PAGE_BYTES  # counters, then the histograms below
DROPS = (
    "superseded",  # a newer message took its place (keep latest)
    "unmatched",  # no partner of its frame came
    "stale",  # older than max_age_ms
    "refused",  # not a message of this schema
    "fenced",  # sent by a superseded instance
    "overwritten",  # its slot was reused before this reader came for it
    "gap",  # the transport lost it
)
HISTOGRAMS = ("handler", "loop", "overhead", "scheduling_delay", "hop")

ROOM_EDGES, ROOM_NODES = 16, 4  # for what is added while a graph runs
_LAYOUT = struct.Struct("<QQ")  # the file ends with how many edges and nodes it has

STATES = ("absent", "starting", "waiting", "busy", "credit", "finished", "stopped")
_STATE_NUMBERS = {name: number for number, name in enumerate(STATES)}


class EdgeAccount(ctypes.Structure):
    """The counters of one edge, each written by one process only."""

    # the writing node
    sent: int
    overrun: int
    broken: int
    # the reading node; the DROPS between the two below
    seen: int
    delivered: int
    unexpected: int
    lost_in_crash: int
    attached_epoch: int
    # the supervisor
    reader_epoch: int
    writer_epoch: int
    receiver_epoch: int  # which instance of the reader packets go to, 0: none
    next_receiver_epoch: int  # and which other one listens while the reader is being swapped
    base: int  # the writer's: how much its output had sent before this edge began

    age: Histogram
    _ends: memoryview

    _fields_ = [
        (name, ctypes.c_uint64)
        for name in (
            "sent", "overrun", "broken", "seen", "delivered", *DROPS, "lost_in_crash",
            "attached_epoch", "unexpected", "reader_epoch", "writer_epoch", "receiver_epoch",
            "next_receiver_epoch", "base",
        )
    ]  # fmt: skip

    @staticmethod
    def over(memory: memoryview) -> "EdgeAccount":
        """The account that lies in EDGE_BYTES of memory."""
        account = EdgeAccount.from_buffer(memory)
        first, last = EdgeAccount.delivered.offset, EdgeAccount.lost_in_crash.offset  # type: ignore[attr-defined]
        account._ends = memory[first : last + 8].cast("Q")
        account.age = Histogram(np.frombuffer(memory, np.uint32, BUCKETS, PAGE_BYTES))
        return account

    def dropped(self, reason: str) -> int:
        """Messages dropped for one of the `DROPS`."""
        return int(getattr(self, reason))

    def acknowledge(self, outcome: str, count: int = 1) -> None:
        """Count the end of messages: delivered, one of the `DROPS`, lost_in_crash."""
        setattr(self, outcome, getattr(self, outcome) + count)

    @property
    def accounted(self) -> int:
        """Messages of which the reader knows the end: delivered, dropped or lost."""
        return sum(self._ends)

    def clear(self) -> None:
        """Begin anew: an edge that was removed, or one that takes its place."""
        ctypes.memset(ctypes.addressof(self), 0, ctypes.sizeof(self))
        self.age.counts[:] = 0

    @property
    def in_flight(self) -> int:
        """Sent and not yet accounted for."""
        return max(0, self.sent - sum(self._ends))

    @property
    def live(self) -> bool:
        """A reader is there and has heard this writer: it counts for back-pressure."""
        reader = self.reader_epoch
        return reader != 0 and self.attached_epoch >= reader

    def report(self) -> dict[str, Any]:
        """The account as the run's report shows it."""
        dropped = {name: self.dropped(name) for name in DROPS if self.dropped(name)}
        if self.overrun:
            dropped["overrun"] = self.overrun
        return {
            "offered": self.sent + self.overrun,
            "delivered": self.delivered,
            "dropped": dropped,
            "in_flight": self.in_flight,
            "lost_in_crash": self.lost_in_crash,
        }


class NodeAccount(ctypes.Structure):
    """The state, the progress and the latencies of one node; the supervisor only announces it."""

    epoch: int
    state: int
    heartbeat_ns: int
    busy_since_ns: int
    handled: int
    last_seq: int

    histograms: dict[str, Histogram]

    _fields_ = [
        (name, ctypes.c_uint64)
        for name in ("epoch", "state", "heartbeat_ns", "busy_since_ns", "handled", "last_seq")
    ]

    @staticmethod
    def over(memory: memoryview) -> "NodeAccount":
        """The account that lies in NODE_BYTES of memory."""
        account = NodeAccount.from_buffer(memory)
        account.histograms = {
            name: Histogram(np.frombuffer(memory, np.uint32, BUCKETS, PAGE_BYTES * (1 + i)))
            for i, name in enumerate(HISTOGRAMS)
        }
        return account

    def clear(self) -> None:
        """Begin anew, for another node."""
        ctypes.memset(ctypes.addressof(self), 0, ctypes.sizeof(self))
        for histogram in self.histograms.values():
            histogram.counts[:] = 0

    @property
    def condition(self) -> str:
        """The state in words."""
        return STATES[min(self.state, len(STATES) - 1)]

    def enter(self, state: str) -> None:
        """Note a change of state."""
        self.state = _STATE_NUMBERS[state]


@dataclass(frozen=True)
class Ledger:
    """The mapped accounts of a graph: edges and nodes in the loader's order."""

    edges: tuple[EdgeAccount, ...]
    nodes: tuple[NodeAccount, ...]

    @staticmethod
    def create(folder: PrivateFolder, edges: int, nodes: int) -> "Ledger":
        """Make the file with room for more; raises `RunError` when there is no room for it."""
        size = ledger_bytes(edges, nodes)
        handle = folder.create(FILE)
        try:
            os.posix_fallocate(handle, 0, size)
            os.pwrite(
                handle, _LAYOUT.pack(edges + ROOM_EDGES, nodes + ROOM_NODES), size - _LAYOUT.size
            )
        except OSError as error:
            folder.remove(FILE)
            raise RunError(f"{folder.path}: no room for {size} bytes of accounts") from error
        finally:
            os.close(handle)
        return Ledger.open(folder)

    @staticmethod
    def open(folder: PrivateFolder) -> "Ledger":
        """Map the accounts of a run; raises `RunError` when they are not there."""
        try:
            with os.fdopen(folder.open(FILE, writable=True), "r+b") as file:
                memory = memoryview(mmap.mmap(file.fileno(), 0))
        except (OSError, ValueError) as error:
            raise RunError(f"{folder.path}: no accounts of a run: {error}") from error
        edges, nodes = _LAYOUT.unpack(memory[-_LAYOUT.size :])
        first = edges * EDGE_BYTES
        return Ledger(
            tuple(EdgeAccount.over(part) for part in _parts(memory, 0, edges, EDGE_BYTES)),
            tuple(NodeAccount.over(part) for part in _parts(memory, first, nodes, NODE_BYTES)),
        )

    def drained(self) -> bool:
        """Nothing is under way on any edge: every message has met its end.

        All ends are read before all beginnings. Edge by edge, a message could leave on one that was
        looked at already and its cause end on one that was not.
        """
        return all(edge.sent == end for edge, end in zip(self.edges, self.ends(), strict=True))

    def ends(self) -> list[int]:
        """Messages that have met their end, by edge."""
        return [edge.accounted for edge in self.edges]


def ledger_bytes(edges: int, nodes: int) -> int:
    """How big the accounts of a graph are, room for more included."""
    return (edges + ROOM_EDGES) * EDGE_BYTES + (nodes + ROOM_NODES) * NODE_BYTES + _LAYOUT.size


def private_ledger(edges: int, nodes: int) -> Ledger:
    """The same accounts in this process's own memory, for the in-line runner and tests."""
    memory = memoryview(bytearray(edges * EDGE_BYTES + nodes * NODE_BYTES))
    first = edges * EDGE_BYTES
    return Ledger(
        tuple(EdgeAccount.over(part) for part in _parts(memory, 0, edges, EDGE_BYTES)),
        tuple(NodeAccount.over(part) for part in _parts(memory, first, nodes, NODE_BYTES)),
    )


def _parts(memory: memoryview, first: int, count: int, size: int) -> Iterable[memoryview]:
    return (memory[first + i * size : first + (i + 1) * size] for i in range(count))
