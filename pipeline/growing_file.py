"""Monitor a file that a library writes in the background, and truncate it when writing fails.

Libraries that write recordings do not report a full disk. Their file is therefore checked once a
second; when it stops growing, it is truncated to its last complete state, so that it is readable.
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
BLOCK_BYTES = 4096  # with less space left, part of the flushed data is missing
FULL_BYTES = 1 << 20  # with less space left, the full disk is what stopped the writer


class GrowingFile:
    """A recording in progress. `flush(seconds)` waits for pending writes; False: they failed."""

    def __init__(self, path: Path, flush: Callable[[float], bool]) -> None:
        self._path, self._flush = path, flush
        self._identity: tuple[int, int] | None = None  # of the file that the library opened
        self._whole_bytes = self._bytes()
        self._seen_bytes = self._whole_bytes
        self._whole_seq: int | None = None
        self._looked_s = time.monotonic()
        self.failure = ""  # one sentence, set when nothing more can be written
        self.ended = False  # the library has closed the file

    def is_written(self, seq: int | None) -> bool:
        """Whether frames up to `seq` reach the file; checked at intervals."""
        if not self.failure and time.monotonic() - self._looked_s >= LOOK_S:
            self.look(seq)
        return not self.failure

    def look(self, seq: int | None) -> None:
        """Wait for pending writes up to frame `seq`, and check that they are in the file."""
        if self.failure:
            return
        arrived = self._flush(FLUSH_S) and self._free_bytes() >= BLOCK_BYTES
        size, before = self._bytes(), self._seen_bytes
        self._looked_s, self._seen_bytes = time.monotonic(), size
        if arrived:
            self._whole_bytes = size
            self._whole_seq = seq if seq is not None else self._whole_seq
        elif size <= before or self._is_full():  # otherwise it is slow, but grows
            self._give_up()

    def close(self, disconnect: Callable[[], None]) -> str:
        """Have the library close the file; return the failure as a sentence, or an empty string.

        A writer that the library cannot end is left alive until the process ends.
        """
        if self.failure:
            return ""
        ending = threading.Thread(target=disconnect, daemon=True)
        ending.start()
        ending.join(CLOSE_S)
        self.ended = not ending.is_alive()
        stopped = self._bytes() <= self._whole_bytes and self._is_full()
        if stopped or self._free_bytes() < BLOCK_BYTES:  # some of its last bytes may be missing
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
        """Return the file's size; 0 when it is gone or replaced by another file."""
        try:
            found = self._path.stat()
        except OSError:
            return 0
        return found.st_size if self._is_it(found) else 0

    def _is_it(self, found: os.stat_result) -> bool:
        """Whether this is the recording, i.e. the file that was seen first."""
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
    """Keep a library's object alive until the process ends.

    Its destructor may wait for a writer thread, which a full disk blocks for ever.
    """
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(writer))
