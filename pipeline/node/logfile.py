"""The log of a node process: bounded in size; a full disk costs words, never the process."""

import io
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Buffer

MOST_BYTES = 16 << 20  # then it becomes `<name>.log.old`, and a new one begins


class LogFile(io.RawIOBase):
    """Where standard output and standard error of this process go, libraries' included."""

    def __init__(self, path: Path, *, fresh: bool, most_bytes: int) -> None:
        self._path, self._most_bytes = path, most_bytes
        self._open(os.O_TRUNC if fresh else 0)

    def writable(self) -> bool:
        """Of course."""
        return True

    def fileno(self) -> int:
        """For those who print without Python: `faulthandler`."""
        return 2

    def write(self, data: "Buffer", /) -> int:
        """Append; what finds no room is forgotten."""
        try:
            if os.fstat(1).st_size > self._most_bytes:
                self._path.replace(self._path.with_suffix(".log.old"))
                self._open(0)
            return os.write(1, data)
        except OSError:
            return memoryview(data).nbytes

    def _open(self, flags: int) -> None:
        handle = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | flags, 0o600)
        for stream in (1, 2):
            os.dup2(handle, stream)
        os.close(handle)


def log_to(path: Path, *, fresh: bool, most_bytes: int = MOST_BYTES) -> None:
    """From now on everything that this process prints goes there."""
    lines = io.BufferedWriter(LogFile(path, fresh=fresh, most_bytes=most_bytes))
    sys.stdout = sys.stderr = io.TextIOWrapper(lines, errors="replace", line_buffering=True)
