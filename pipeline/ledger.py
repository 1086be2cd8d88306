"""The accounts of a graph in shared memory: who was offered what, and what became of it.

One file holds a page per edge and a page per node. Every counter has a single writer, so no lock is
needed, and nothing is lost when a process is killed: its successor goes on from the same numbers.

    offered = delivered + dropped + in flight + lost in a crash
"""

import mmap
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import RunError
from pipeline.histogram import BUCKETS, Histogram

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
HISTOGRAMS = ("handler", "loop", "overhead", "cpu_wait", "hop")

# counters of an edge and who writes them
_EDGE = {
    name: index
    for index, name in enumerate(
        (
            "sent", "overrun", "broken",  # the writing node
            "seen", "delivered", *DROPS, "lost_in_crash",  # the reading node
            "attached_epoch", "strays",  # likewise
            "reader_epoch", "writer_epoch",  # the supervisor
        )
    )
}  # fmt: skip
_NODE = {
    name: index
    for index, name in enumerate(
        ("epoch", "state", "heartbeat_ns", "busy_since_ns", "handled", "last_seq")
    )
}
_STATE_WORD = _NODE["state"]
STATES = ("absent", "starting", "waiting", "busy", "credit", "finished", "stopped")

_STATE_NUMBERS = {name: number for number, name in enumerate(STATES)}


def _counter(name: str) -> property:
    index = _EDGE[name]
    return property(lambda account: account._words[index])


def _progress(name: str) -> property:
    index = _NODE[name]
    return property(lambda account: account._words[index])


class EdgeAccount:
    """The counters of one edge. Attribute access reads; `add` and `put` write one counter."""

    def __init__(self, memory: memoryview) -> None:
        self._words = memory[:PAGE_BYTES].cast("Q")
        self.age = Histogram(np.frombuffer(memory, np.uint32, BUCKETS, PAGE_BYTES))

    sent, overrun, broken = _counter("sent"), _counter("overrun"), _counter("broken")
    seen, delivered = _counter("seen"), _counter("delivered")
    lost_in_crash, strays = _counter("lost_in_crash"), _counter("strays")
    attached_epoch = _counter("attached_epoch")
    reader_epoch, writer_epoch = _counter("reader_epoch"), _counter("writer_epoch")

    def dropped(self, reason: str) -> int:
        """Messages dropped for one of the `DROPS`."""
        return self._words[_EDGE[reason]]

    def add(self, name: str, count: int = 1) -> None:
        """Count: only the counter's single writer may."""
        self._words[_EDGE[name]] += count

    def put(self, name: str, value: int) -> None:
        """Overwrite: only the counter's single writer may."""
        self._words[_EDGE[name]] = value

    @property
    def accounted(self) -> int:
        """Messages of which the reader knows the end: delivered, dropped or lost."""
        w = self._words
        first = _EDGE["delivered"]
        return sum(w[first : _EDGE["lost_in_crash"] + 1])

    @property
    def in_flight(self) -> int:
        """Sent and not yet accounted for."""
        return max(0, int(self.sent) - self.accounted)

    @property
    def live(self) -> bool:
        """A reader is there and has heard this writer: it counts for back-pressure."""
        w = self._words
        return w[_EDGE["reader_epoch"]] != 0 and (
            w[_EDGE["attached_epoch"]] == w[_EDGE["reader_epoch"]]
        )

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


class NodeAccount:
    """The state, the progress and the latencies of one node."""

    def __init__(self, memory: memoryview) -> None:
        self._words = memory[:PAGE_BYTES].cast("Q")
        self.histograms = {
            name: Histogram(np.frombuffer(memory, np.uint32, BUCKETS, PAGE_BYTES * (1 + i)))
            for i, name in enumerate(HISTOGRAMS)
        }

    epoch, handled = _progress("epoch"), _progress("handled")
    state, last_seq = _progress("state"), _progress("last_seq")
    heartbeat_ns, busy_since_ns = _progress("heartbeat_ns"), _progress("busy_since_ns")

    def add(self, name: str, count: int = 1) -> None:
        """Count: only the node itself may."""
        self._words[_NODE[name]] += count

    def put(self, name: str, value: int) -> None:
        """Overwrite: only the node itself may; the supervisor before it starts the node."""
        self._words[_NODE[name]] = value

    @property
    def condition(self) -> str:
        """The state in words."""
        return STATES[min(self.state, len(STATES) - 1)]

    def enter(self, state: str) -> None:
        """Note a change of state."""
        self._words[_STATE_WORD] = _STATE_NUMBERS[state]


@dataclass(frozen=True)
class Ledger:
    """The mapped accounts of a graph: edges and nodes in the loader's order."""

    path: Path
    edges: tuple[EdgeAccount, ...]
    nodes: tuple[NodeAccount, ...]

    @staticmethod
    def create(path: Path, edges: int, nodes: int) -> "Ledger":
        """Make the file; raises `RunError` when there is no room for it."""
        size = edges * EDGE_BYTES + nodes * NODE_BYTES
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            os.posix_fallocate(handle, 0, max(size, PAGE_BYTES))
        except OSError as error:
            path.unlink()
            raise RunError(f"{path.parent}: no room for {size} bytes of accounts") from error
        finally:
            os.close(handle)
        return Ledger.open(path, edges, nodes)

    @staticmethod
    def open(path: Path, edges: int, nodes: int) -> "Ledger":
        """Map an existing file."""
        with path.open("r+b") as file:
            memory = memoryview(mmap.mmap(file.fileno(), 0))
        first = edges * EDGE_BYTES
        return Ledger(
            path,
            tuple(EdgeAccount(part) for part in _parts(memory, 0, edges, EDGE_BYTES)),
            tuple(NodeAccount(part) for part in _parts(memory, first, nodes, NODE_BYTES)),
        )

    def drained(self) -> bool:
        """Nothing is under way on any edge: every message has met its end."""
        return all(edge.sent == edge.accounted for edge in self.edges)


def private_ledger(edges: int, nodes: int) -> Ledger:
    """The same accounts in this process's own memory, for the in-line runner and tests."""
    memory = memoryview(bytearray(edges * EDGE_BYTES + nodes * NODE_BYTES))
    first = edges * EDGE_BYTES
    return Ledger(
        Path(),
        tuple(EdgeAccount(part) for part in _parts(memory, 0, edges, EDGE_BYTES)),
        tuple(NodeAccount(part) for part in _parts(memory, first, nodes, NODE_BYTES)),
    )


def _parts(memory: memoryview, first: int, count: int, size: int) -> Iterable[memoryview]:
    return (memory[first + i * size : first + (i + 1) * size] for i in range(count))
