"""Standard output and error of a command whose reader may close or whose terminal may vanish.

A command that only prints a result then ends quietly. A command that keeps a graph running loses
output and nothing else (`forgive`), even when the reader stops reading.
"""

import contextlib
import errno
import io
import os
import select
import sys
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from typing_extensions import Buffer

TIMEOUT_S = 0.1  # one wait for a reader that does not read
_ATOMIC = 512  # bytes that a writable pipe accepts without blocking (POSIX)


class Outlet(io.RawIOBase):
    """Standard output or error of a command that continues when it cannot be written."""

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self._lost = self._stuck = False

    def writable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._handle

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return os.isatty(self._handle)

    def write(self, data: "Buffer", /) -> int:
        """Write; discard what the reader does not accept."""
        view = memoryview(data).cast("B")
        if self._lost or not self._takes():
            return view.nbytes
        try:
            return os.write(self._handle, view[:_ATOMIC])
        except BlockingIOError:  # another program has made the terminal non-blocking
            return view.nbytes
        except OSError:
            self._lost = True
            return view.nbytes

    def _takes(self) -> bool:
        """Whether the reader reads; after one timeout, wait no more until it reads again."""
        poll = select.poll()
        poll.register(self._handle, select.POLLOUT)
        self._stuck = not poll.poll(0 if self._stuck else 1000 * TIMEOUT_S)
        return not self._stuck


_kept: dict[int, int] = {}  # duplicates of both original descriptors


def complain(text: str) -> None:
    """Print why a command fails, even if an operator has closed or replaced the streams.

    Raises `OSError` when the reader has closed the stream.
    """
    for handle, kept in _kept.items():
        try:
            os.fstat(handle)
        except OSError:
            os.dup2(kept, handle)
    try:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()
    except (AttributeError, TypeError, ValueError):  # None, closed, or not a stream
        os.write(2, f"{text}\n".encode(errors="backslashreplace"))


def guard() -> None:
    """Make both streams accept any text; redirect closed descriptors to the null device."""
    for handle in range(3):
        try:
            os.fstat(handle)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor: this one
    sys.stdout, sys.stderr = _tolerant(sys.stdout, 1), _tolerant(sys.stderr, 2)
    for handle in (1, 2):
        with contextlib.suppress(OSError):  # no descriptor is left
            _kept[handle] = _kept.get(handle) or os.dup(handle)


def forgive() -> None:
    """From now on, discard output that cannot be written instead of raising."""
    for handle, stream in ((1, sys.stdout), (2, sys.stderr)):
        stream.flush()
        through = io.TextIOWrapper(
            io.BufferedWriter(Outlet(handle)), stream.encoding, errors="backslashreplace",
            line_buffering=handle == 2 or os.isatty(handle),
        )  # fmt: skip
        if handle == 1:
            sys.stdout = through
        else:
            sys.stderr = through


def flush() -> None:
    """Flush both streams."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()


def redirect(target: int) -> None:
    """Redirect both streams to a descriptor, and close their former targets."""
    flush()
    for handle in (1, 2):
        os.dup2(target, handle)
    for kept in _kept.values():
        os.dup2(target, kept, inheritable=False)


def abandon() -> None:
    """Discard all further output of a command whose reader has closed the stream."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    for handle in (1, 2):
        os.dup2(nothing, handle)
    os.close(nothing)


def is_lost(error: OSError) -> bool:
    """Whether an error means that the reader of a stream, or its terminal, is gone."""
    return error.errno in (errno.EPIPE, errno.EIO) and error.filename is None


def _tolerant(stream: TextIO | None, handle: int) -> TextIO:
    if stream is None:  # it was closed when Python started
        return io.TextIOWrapper(os.fdopen(handle, "wb", closefd=False), "utf-8")
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(errors="backslashreplace")
    return stream
