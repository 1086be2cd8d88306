"""The log of a process: bounded in size; a full disk costs words, never the process."""

import contextlib
import fcntl
import io
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Buffer

MOST_BYTES = 16 << 20  # then it becomes `<name>.old`, and a new one begins
FIRST_OWN = 3  # the standard descriptors may be closed: their numbers are not taken


class LogFile(io.RawIOBase):
    """Where standard output and standard error of this process go, libraries' included.

    It writes through a descriptor of its own: an operator may close the standard ones, and what it
    opens then gets their numbers.
    """

    def __init__(self, path: Path, *, fresh: bool, most_bytes: int) -> None:
        self._path, self._most_bytes = path, most_bytes
        self._handle = -1
        self._open(os.O_TRUNC if fresh else 0)

    def writable(self) -> bool:
        """Return that it can be written."""
        return True

    def fileno(self) -> int:
        """Return the descriptor, for `faulthandler`, which prints without Python."""
        return self._handle

    def write(self, data: "Buffer", /) -> int:
        """Append; what finds no room is forgotten."""
        with contextlib.suppress(OSError):
            self.look()
            return os.write(self._handle, data)
        return memoryview(data).nbytes

    def look(self) -> None:
        """Begin a new file when this one is full, also by a child of the node; raises `OSError`."""
        if os.fstat(self._handle).st_size > self._most_bytes:
            self._path.replace(self._path.with_name(f"{self._path.name}.old"))
            self._open(0)

    def _open(self, flags: int) -> None:
        handle = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | flags, 0o600)
        streams = [s for s in (1, 2) if self._handle < 0 or self._is_here(s)]
        if self._handle < 0:
            self._handle = fcntl.fcntl(handle, fcntl.F_DUPFD_CLOEXEC, FIRST_OWN)
        else:
            os.dup2(handle, self._handle, inheritable=False)
        for stream in streams:
            os.dup2(handle, stream)
        os.close(handle)

    def _is_here(self, stream: int) -> bool:
        """Whether a standard stream leads to this log; an operator may have moved it."""
        try:
            return os.path.samestat(os.fstat(stream), os.fstat(self._handle))
        except OSError:
            return False


def log_to(path: Path, *, fresh: bool, most_bytes: int = MOST_BYTES) -> LogFile:
    """Have everything that this process prints from now on go there."""
    file = LogFile(path, fresh=fresh, most_bytes=most_bytes)
    lines = io.BufferedWriter(file)
    sys.stdout = sys.stderr = io.TextIOWrapper(lines, errors="replace", line_buffering=True)
    return file
