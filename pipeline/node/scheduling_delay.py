"""Scheduling delay: time in which a thread was runnable but waited for a core, per kernel."""

import os
import threading


class SchedulingDelay:
    """The delay of each calling thread since its last call, in nanoseconds.

    Each calling thread keeps a file open. The transport's threads, which are new to Python with
    every message, must not call it.
    """

    def __init__(self) -> None:
        self._local = threading.local()

    def since_last_ns(self) -> int:
        """Return the delay since this thread's last call; 0 at first or without kernel support."""
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
