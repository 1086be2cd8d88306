"""How long this thread was runnable and waited for a processor, as the kernel counts it."""

import os
import threading


class SchedulingDelay:
    """Nanoseconds of waiting since the last question, per thread that asks.

    A thread that asked holds a file open; the transport's, new to Python with every message, must
    not ask.
    """

    def __init__(self) -> None:
        self._local = threading.local()

    def since_last_ns(self) -> int:
        """Waited since this thread asked before; 0 at first, and where the kernel does not say."""
        local = self._local
        if not hasattr(local, "handle"):
            local.handle, local.last = _open(), 0
            local.last = self._total(local.handle)
            return 0
        now = self._total(local.handle)
        waited: int = now - local.last
        local.last = now
        return waited

    @staticmethod
    def _total(handle: int) -> int:
        if handle < 0:
            return 0
        return int(os.pread(handle, 64, 0).split()[1])


def _open() -> int:
    try:
        return os.open("/proc/thread-self/schedstat", os.O_RDONLY)
    except OSError:
        return -1
