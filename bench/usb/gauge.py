"""What a virtual board itself costs: `GaugedBoard`."""

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.usb.frame_header import Stream
from drivers.virtual_board.board import VirtualBoard


class Gauge:
    """Sums over the calls of a board; used by any number of threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cpu_ns = self._bytes = self._reads = 0
        self._begun_ns = self._last_ns = 0
        self._process_ns = (0, 0)  # processor time of the process, at the first and the last read

    @contextmanager
    def spent(self) -> Iterator[None]:
        """Count the processor time of a block, from the first read on."""
        began_ns = time.thread_time_ns()
        try:
            yield
        finally:
            with self._lock:
                if self._begun_ns:
                    self._cpu_ns += time.thread_time_ns() - began_ns

    def begins(self) -> None:
        """Note that the board has a read to answer."""
        now_ns = time.monotonic_ns()
        with self._lock:
            if not self._begun_ns:
                self._begun_ns, self._process_ns = now_ns, (time.process_time_ns(),) * 2

    def ends(self, count: int | None) -> None:
        """Note that a read was answered, with so many bytes; None: nothing came in time."""
        with self._lock:
            if count:
                self._bytes += count
                self._reads += 1
                self._last_ns = time.monotonic_ns()
                self._process_ns = self._process_ns[0], time.process_time_ns()

    def figures(self) -> dict[str, Any]:
        """Return the figures from the first read to the last that brought bytes."""
        with self._lock:
            elapsed_s = max(1e-9, (self._last_ns - self._begun_ns) / 1e9)
            process_ns = self._process_ns[1] - self._process_ns[0]
            return {
                "seconds": round(elapsed_s, 3),
                "reads": self._reads,
                "megabytes_per_s": round(self._bytes / elapsed_s / 1e6, 1),
                "cpu_percent": round(self._cpu_ns / 1e7 / elapsed_s, 1),
                "share_of_its_process_percent": round(100 * self._cpu_ns / max(1, process_ns), 1),
            }


class GaugedBoard(VirtualBoard):
    """A virtual board that counts its own processor time. What it copies to the host counts."""

    def __init__(self, *given: Any, **named: Any) -> None:
        self.gauge = Gauge()
        super().__init__(*given, **named)

    def ask(self, request: int, length: int) -> bytes:
        """Answer an IN request."""
        with self.gauge.spent():
            return super().ask(request, length)

    def tell(self, request: int, value: int, data: bytes) -> None:
        """Do what an OUT request asks."""
        with self.gauge.spent():
            super().tell(request, value, data)

    def read(self, stream: Stream, memory: NDArray[np.uint8], timeout_s: float) -> int | None:
        """Send the next bytes of a stream."""
        count = None
        asked_ns = time.monotonic_ns()
        self.gauge.begins()
        try:
            with self.gauge.spent():
                count = super().read(stream, memory, timeout_s)
                if count:
                    self.carry(memory[:count], asked_ns)
        finally:
            self.gauge.ends(count)
        return count

    def carry(self, sent: NDArray[np.uint8], asked_ns: int) -> None:
        """Take the time of what was sent (n,), which was asked for then; here none."""


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return median, 99th percentile and the largest, 0 of nothing.

    >>> spread([1.0, 2.0, 3.0])
    {'p50': 2.0, 'p99': 2.98, 'most': 3.0}
    """
    if not len(values):
        return {"p50": 0.0, "p99": 0.0, "most": 0.0}
    p50, p99, most = np.percentile(values, (50, 99, 100))
    return {"p50": round(float(p50), 3), "p99": round(float(p99), 3), "most": round(float(most), 3)}
