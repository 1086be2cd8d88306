"""A file that a library writes in the background: does it still grow, and up to where is it whole?

Libraries that write recordings do not tell of a full disk. Their file is looked at once a second
instead; when it stops growing it is cut where it was whole last, so that it can be read.
"""

import contextlib
import ctypes
import os
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

LOOK_S = 1.0
FLUSH_S = 2.0
CLOSE_S = 2.0
BLOCK_BYTES = 4096  # with less than this left, a part of what was flushed is not there
FULL_BYTES = 1 << 20  # with less than this left, the disk is what stopped the writer


class GrowingFile:
    """A recording under way. `flush` waits so long for what was written; False: it is not there."""

    def __init__(self, path: Path, flush: Callable[[float], bool]) -> None:
        self._path, self._flush = path, flush
        self._identity: tuple[int, int] | None = None  # of the file that the library has opened
        self._whole_bytes = self._bytes()
        self._seen_bytes = self._whole_bytes
        self._whole_seq: int | None = None
        self._looked_s = time.monotonic()
        self.failure = ""  # one sentence, once nothing more can be written
        self.ended = False  # the library has ended the file

    def is_written(self, seq: int | None) -> bool:
        """Whether what was handed to the library up to a frame arrives; looked at at times."""
        if not self.failure and time.monotonic() - self._looked_s >= LOOK_S:
            self.look(seq)
        return not self.failure

    def look(self, seq: int | None) -> None:
        """Wait for what was written up to a frame, and find out whether it is in the file."""
        if self.failure:
            return
        arrived = self._flush(FLUSH_S) and self._free_bytes() >= BLOCK_BYTES
        size, before = self._bytes(), self._seen_bytes
        self._looked_s, self._seen_bytes = time.monotonic(), size
        if arrived:
            self._whole_bytes = size
            self._whole_seq = seq if seq is not None else self._whole_seq
        elif size <= before or self._is_full():  # else it is slow, and grows
            self._give_up()

    def close(self, disconnect: Callable[[], None]) -> str:
        """Have the library end the file; returns what goes wrong over it.

        What the library cannot end is left to the end of the process.
        """
        if self.failure:
            return ""
        ending = threading.Thread(target=disconnect, daemon=True)
        ending.start()
        ending.join(CLOSE_S)
        self.ended = not ending.is_alive()
        stopped = self._bytes() <= self._whole_bytes and self._is_full()
        if stopped or self._free_bytes() < BLOCK_BYTES:  # its last bytes are missing, or some
            self._give_up()
        return self.failure

    def _give_up(self) -> None:
        with contextlib.suppress(OSError):
            handle = os.open(self._path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                if self._is_it(os.fstat(handle)):
                    os.ftruncate(handle, self._whole_bytes)
            finally:
                os.close(handle)
        why = "the disk is full" if self._is_full() else "its writer stopped"
        until = "nothing of it can be read"
        if self._whole_seq is not None:
            until = f"it can be read up to frame {self._whole_seq}"
        self.failure = f"{self._path}: {why}; {until}"

    def _bytes(self) -> int:
        """As many as it has; 0 when it is gone, or another file has taken its name."""
        try:
            found = self._path.stat()
        except OSError:
            return 0
        return found.st_size if self._is_it(found) else 0

    def _is_it(self, found: os.stat_result) -> bool:
        """Whether it is the recording: the file that was seen first."""
        if self._identity is None:
            self._identity = found.st_dev, found.st_ino
        return self._identity == (found.st_dev, found.st_ino)

    def _is_full(self) -> bool:
        return self._free_bytes() < FULL_BYTES

    def _free_bytes(self) -> int:
        try:
            return shutil.disk_usage(self._path.parent).free
        except OSError:
            return FULL_BYTES


def never_collect(writer: object) -> None:
    """Leave a library's object to the end of the process.

    Its destructor may wait for a writer thread, which a full disk stops for ever.
    """
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(writer))
