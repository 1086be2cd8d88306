"""The accounts of a graph in shared memory: messages offered on each edge and their outcome.

One file holds the pages of every edge and node. Every counter has a single writer, so no lock is
needed, and a killed process loses no counts: its successor continues from the same numbers.

    offered = delivered + dropped + in flight + lost with a process
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
from pipeline.text import harmless

FILE = "ledger"  # in the memory folder of the run
PAGE_BYTES = 4096
EDGE_BYTES = 2 * PAGE_BYTES  # counters, then the histogram of ages
NODE_BYTES = 6 * PAGE_BYTES  # counters, then the histograms below
DROPS = (
    "superseded",  # replaced by a newer message (keep latest)
    "unmatched",  # another member of its set is missing
    "stale",  # older than max_age_ms
    "refused",  # no message of this schema
    "fenced",  # sent by a superseded instance
    "overwritten",  # its slot was reused before this reader got to it
    "gap",  # lost by the transport
)
HISTOGRAMS = ("handler", "loop", "overhead", "scheduling_delay", "hop")

ROOM_EDGES, ROOM_NODES = 64, 8  # spare pages for what joins a running graph, viewers among it
_LAYOUT = struct.Struct("<QQ")  # the file ends with its numbers of edges and nodes

STATES = ("absent", "starting", "waiting", "busy", "credit", "finished", "stopped")
PROVIDER_BYTES = 64  # of the names of a node's providers, with a zero at the end
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
    receiver_epoch: int  # the reader's instance that receives packets, 0: none
    next_receiver_epoch: int  # a second one, while the reader is being swapped
    base: int  # the writer's: what its output had sent before this edge existed

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
        """Map the account in EDGE_BYTES of memory."""
        account = EdgeAccount.from_buffer(memory)
        first, last = EdgeAccount.delivered.offset, EdgeAccount.lost_in_crash.offset  # type: ignore[attr-defined]
        account._ends = memory[first : last + 8].cast("Q")
        account.age = Histogram(np.frombuffer(memory, np.uint32, BUCKETS, PAGE_BYTES))
        return account

    def dropped(self, reason: str) -> int:
        """Return the number of messages dropped for one of the `DROPS`."""
        return int(getattr(self, reason))

    def acknowledge(self, outcome: str, count: int = 1) -> None:
        """Count messages with an outcome: delivered, one of the `DROPS`, or lost_in_crash."""
        setattr(self, outcome, getattr(self, outcome) + count)

    @property
    def accounted(self) -> int:
        """Number of messages with an outcome: delivered, dropped or lost."""
        return sum(self._ends)

    def clear(self) -> None:
        """Reset the account of a removed edge, or for the edge that reuses it."""
        ctypes.memset(ctypes.addressof(self), 0, ctypes.sizeof(self))
        self.age.counts[:] = 0

    @property
    def in_flight(self) -> int:
        """Number of messages sent and not yet accounted for."""
        return max(0, self.sent - sum(self._ends))

    @property
    def live(self) -> bool:
        """Whether a reader has received this writer's handshake: it then exerts back-pressure."""
        reader = self.reader_epoch
        return reader != 0 and self.attached_epoch >= reader

    def report(self) -> dict[str, Any]:
        """Return the account for the report of the run."""
        dropped = {name: self.dropped(name) for name in DROPS if self.dropped(name)}
        if self.overrun:
            dropped["overrun"] = self.overrun
        return {
            "offered": self.sent + self.overrun,
            "delivered": self.delivered,
            "dropped": dropped,
            "in_flight": self.in_flight,
            "lost_in_crash": self.lost_in_crash,
            "unexpected": self.unexpected,  # beside the messages: damaged, or sent twice
        }


class NodeAccount(ctypes.Structure):
    """State, progress and latencies of one node; the supervisor only announces it."""

    epoch: int
    state: int
    heartbeat_ns: int
    busy_since_ns: int
    handled: int
    last_seq: int
    absent_until_ns: int  # until when a source waits for a lost device, or when it last did
    _provider: bytes

    histograms: dict[str, Histogram]

    _fields_ = [
        *((name, ctypes.c_uint64)
          for name in (
              "epoch", "state", "heartbeat_ns", "busy_since_ns", "handled", "last_seq",
              "absent_until_ns",
          )),
        ("_provider", ctypes.c_char * PROVIDER_BYTES),
    ]  # fmt: skip

    @staticmethod
    def over(memory: memoryview) -> "NodeAccount":
        """Map the account in NODE_BYTES of memory."""
        account = NodeAccount.from_buffer(memory)
        account.histograms = {
            name: Histogram(np.frombuffer(memory, np.uint32, BUCKETS, PAGE_BYTES * (1 + i)))
            for i, name in enumerate(HISTOGRAMS)
        }
        return account

    def clear(self) -> None:
        """Reset the account for another node."""
        ctypes.memset(ctypes.addressof(self), 0, ctypes.sizeof(self))
        for histogram in self.histograms.values():
            histogram.counts[:] = 0

    @property
    def condition(self) -> str:
        """The name of the state."""
        return STATES[min(self.state, len(STATES) - 1)]

    @property
    def provider(self) -> str:
        """What computes the node's networks, as its operator names it; empty without one.

        A reader may come while it is written: it then gets a mixture, and the names a second later.
        """
        return harmless(self._provider.decode("ascii", "replace"), PROVIDER_BYTES)

    @provider.setter
    def provider(self, names: str) -> None:
        written = names.encode("ascii", "replace")[: PROVIDER_BYTES - 1]
        if written != self._provider:
            self._provider = written

    def enter(self, state: str) -> None:
        """Record a change of state."""
        self.state = _STATE_NUMBERS[state]


@dataclass(frozen=True)
class Ledger:
    """The mapped accounts of a graph: edges and nodes in the order of the loader."""

    edges: tuple[EdgeAccount, ...]
    nodes: tuple[NodeAccount, ...]

    @staticmethod
    def create(folder: PrivateFolder, edges: int, nodes: int) -> "Ledger":
        """Create the file with spare pages; raises `RunError` when memory is short."""
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
        """Map the accounts of a run; raises `RunError` when they do not exist."""
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
        """Whether no message is in flight on any edge.

        All outcomes are read before any count of sent messages. Edge by edge, a message could be
        sent on an edge already checked while its cause ends on one that is not.
        """
        used = [edge for edge in self.edges if edge.sent]  # most spare pages are not
        ends = [edge.accounted for edge in used]
        sent = [edge.sent for edge in self.edges if edge.sent]
        return sent == ends

    def ends(self) -> list[int]:
        """Return the number of messages with an outcome, by edge."""
        return [edge.accounted for edge in self.edges]


def ledger_bytes(edges: int, nodes: int) -> int:
    """Return the size of a graph's ledger, including spare pages."""
    return (edges + ROOM_EDGES) * EDGE_BYTES + (nodes + ROOM_NODES) * NODE_BYTES + _LAYOUT.size


def private_ledger(edges: int, nodes: int) -> Ledger:
    """Return a ledger in this process's own memory, for the in-line runner and tests."""
    memory = memoryview(bytearray(edges * EDGE_BYTES + nodes * NODE_BYTES))
    first = edges * EDGE_BYTES
    return Ledger(
        tuple(EdgeAccount.over(part) for part in _parts(memory, 0, edges, EDGE_BYTES)),
        tuple(NodeAccount.over(part) for part in _parts(memory, first, nodes, NODE_BYTES)),
    )


def _parts(memory: memoryview, first: int, count: int, size: int) -> Iterable[memoryview]:
    return (memory[first + i * size : first + (i + 1) * size] for i in range(count))
