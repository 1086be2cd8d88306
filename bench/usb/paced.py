"""The time that a link takes for its bytes while the host keeps several reads in flight."""

import threading
import time

from drivers.usb.frame_header import HEADER_BYTES, Stream
from drivers.usb.link import CHUNK_BYTES


class PacedLink:
    """Makes each bulk read last as long as its bytes take.

    A backend of pyusb is asked for one read after the other. With `reads` in flight the link goes
    on meanwhile: it may be ahead of the host by as many reads, within the payloads of an exposure.
    It never begins before the host has a header, since only then the driver knows where to put the
    pixels. With 1 it waits for every read.
    """

    def __init__(self, bytes_per_s: int, reads: int) -> None:
        self._ns_per_byte = 1e9 / bytes_per_s
        self._ahead_ns = round((reads - 1) * CHUNK_BYTES * self._ns_per_byte)
        self._free_ns = 0
        self._began = dict.fromkeys(Stream, False)  # whether a payload has begun
        self._lock = threading.Lock()

    def carry(self, stream: Stream, count: int) -> None:
        """Wait until the link has carried so many bytes."""
        until_ns = self.until_ns(stream, count, time.monotonic_ns())
        time.sleep(max(0, until_ns - time.monotonic_ns()) / 1e9)

    def until_ns(self, stream: Stream, count: int, now_ns: int) -> int:
        """Return when these bytes, asked for by now, have been carried."""
        with self._lock:
            begun = self._began[stream] or stream is Stream.ROI
            header = count == HEADER_BYTES
            self._began[stream] = not header
            earliest_ns = now_ns if header or not begun else now_ns - self._ahead_ns
            self._free_ns = max(self._free_ns, earliest_ns) + round(count * self._ns_per_byte)
            return self._free_ns
