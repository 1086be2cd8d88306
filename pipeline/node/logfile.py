"""Log of a process: bounded in size; a full disk loses output, never the process."""

import contextlib
import fcntl
import io
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Buffer

MOST_BYTES = 16 << 20  # then the file is renamed to `<name>.old`
FIRST_OWN = 3  # standard descriptors may be closed: do not use their numbers


class LogFile(io.RawIOBase):
    """The target of this process's standard output and error, including those of libraries.

    It writes through its own descriptor: an operator may close the standard ones, whose numbers are
    then reused.
    """

    def __init__(self, path: Path, *, fresh: bool, most_bytes: int) -> None:
        self._path, self._most_bytes = path, most_bytes
        self._handle = -1
        self._open(os.O_TRUNC if fresh else 0)

    def writable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the descriptor, for `faulthandler`, which prints without Python."""
        return self._handle

    def write(self, data: "Buffer", /) -> int:
        """Append; discard what does not fit on the disk."""
        with contextlib.suppress(OSError):
            self.look()
            return os.write(self._handle, data)
        return memoryview(data).nbytes

    def look(self) -> None:
        """Start a new file when this one is full, maybe by a child's output; raises `OSError`."""
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
        """Whether a standard stream leads to this log; an operator may have redirected it."""
        try:
            return os.path.samestat(os.fstat(stream), os.fstat(self._handle))
        except OSError:
            return False


def log_to(path: Path, *, fresh: bool, most_bytes: int = MOST_BYTES) -> LogFile:
    """Redirect all output of this process to a log file."""
    file = LogFile(path, fresh=fresh, most_bytes=most_bytes)
    lines = io.BufferedWriter(file)
    sys.stdout = sys.stderr = io.TextIOWrapper(lines, errors="replace", line_buffering=True)
    return file
