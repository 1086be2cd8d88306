"""The time that a link takes for its bytes while the driver keeps several reads in flight."""

import threading
import time
from array import array
from collections import deque
from collections.abc import Sequence


class PacedLink:
    """Makes each bulk read last as long as its bytes take.

    A backend of pyusb is asked for one read after the other. The driver keeps `reads` in flight
    over libusb, those of the next exposure included (`drivers.usb.receiver`). So the link begins a
    read when it has carried the one before, the frame is ready, and the read that is `reads` before
    it has returned, because it was submitted then. A single read is submitted when it is asked for.
    """

    def __init__(self, bytes_per_s: int, reads: int) -> None:
        self._ns_per_byte, self._reads = 1e9 / bytes_per_s, reads
        self._free_ns = 0
        self._returned_ns: deque[int] = deque(maxlen=reads)  # of the reads that are over
        self._gaps_ms = array("d")
        self._lock = threading.Lock()

    def carry(self, count: int, *, asked_ns: int, ready_ns: int = 0) -> None:
        """Wait until the link has carried so many bytes, asked for and ready at these times."""
        until_ns = self.until_ns(count, asked_ns=asked_ns, ready_ns=ready_ns)
        time.sleep(max(0, until_ns - time.monotonic_ns()) / 1e9)
        self.returned(time.monotonic_ns())

    def until_ns(self, count: int, *, asked_ns: int, ready_ns: int = 0) -> int:
        """Return when these bytes have been carried."""
        with self._lock:
            submitted_ns = asked_ns
            if self._reads > 1:
                full = len(self._returned_ns) == self._reads
                submitted_ns = min(asked_ns, self._returned_ns[0]) if full else 0
            due_ns = max(self._free_ns, ready_ns)
            begin_ns = max(due_ns, submitted_ns)
            if self._free_ns:
                self._gaps_ms.append((begin_ns - due_ns) / 1e6)
            self._free_ns = begin_ns + round(count * self._ns_per_byte)
            return self._free_ns

    def returned(self, at_ns: int) -> None:
        """Note that a read has returned to the driver, which submits another one."""
        with self._lock:
            self._returned_ns.append(at_ns)

    def gaps_ms(self) -> Sequence[float]:
        """How long the link waited for a read while a frame was ready, before each read."""
        with self._lock:
            return list(self._gaps_ms)
