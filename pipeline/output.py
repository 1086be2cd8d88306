"""Standard output and standard error of a command: a reader may leave, a terminal may vanish.

A command whose standard output is its answer ends then, quietly. One that keeps a graph running
loses words and nothing else (`forgive`), also where a reader stops reading.
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

TIMEOUT_S = 0.1  # for a reader that does not read, once
_ATOMIC = 512  # bytes that a pipe which can be written takes without waiting (POSIX)


class Outlet(io.RawIOBase):
    """One of the two, of a command that goes on without it."""

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self._lost = self._stuck = False

    def writable(self) -> bool:
        """Return that it can be written."""
        return True

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._handle

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return os.isatty(self._handle)

    def write(self, data: "Buffer", /) -> int:
        """Write; what the reader does not take is forgotten."""
        view = memoryview(data).cast("B")
        if self._lost or not self._takes():
            return view.nbytes
        try:
            return os.write(self._handle, view[:_ATOMIC])
        except BlockingIOError:  # another program has made the terminal so
            return view.nbytes
        except OSError:
            self._lost = True
            return view.nbytes

    def _takes(self) -> bool:
        """Whether the reader reads; one that did not is waited for no more, until it does."""
        poll = select.poll()
        poll.register(self._handle, select.POLLOUT)
        self._stuck = not poll.poll(0 if self._stuck else 1000 * TIMEOUT_S)
        return not self._stuck


_kept: dict[int, int] = {}  # both descriptors as they were at first


def complain(text: str) -> None:
    """Tell why a command fails, also where an operator's code has closed or replaced the streams.

    Raises `OSError` when the reader has left.
    """
    for handle, kept in _kept.items():
        try:
            os.fstat(handle)
        except OSError:
            os.dup2(kept, handle)
    try:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()
    except (AttributeError, TypeError, ValueError):  # None, closed, or no stream at all
        os.write(2, f"{text}\n".encode(errors="backslashreplace"))


def guard() -> None:
    """Have both streams take any text; descriptors that are closed lead nowhere."""
    for handle in range(3):
        try:
            os.fstat(handle)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest that is free: this one
    sys.stdout, sys.stderr = _tolerant(sys.stdout, 1), _tolerant(sys.stderr, 2)
    for handle in (1, 2):
        with contextlib.suppress(OSError):  # none is left
            _kept[handle] = _kept.get(handle) or os.dup(handle)


def forgive() -> None:
    """From now on let a stream that cannot be written cost its words alone."""
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
    """Write what both streams hold back."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()


def redirect(target: int) -> None:
    """Have both streams lead to a descriptor, and let go of where they led before."""
    flush()
    for handle in (1, 2):
        os.dup2(target, handle)
    for kept in _kept.values():
        os.dup2(target, kept, inheritable=False)


def abandon() -> None:
    """Of a command whose reader has left: what it still says leads nowhere."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    for handle in (1, 2):
        os.dup2(nothing, handle)
    os.close(nothing)


def is_lost(error: OSError) -> bool:
    """Whether an error says that the reader of a stream has left, or its terminal."""
    return error.errno in (errno.EPIPE, errno.EIO) and error.filename is None


def _tolerant(stream: TextIO | None, handle: int) -> TextIO:
    if stream is None:  # it was closed when Python came up
        return io.TextIOWrapper(os.fdopen(handle, "wb", closefd=False), "utf-8")
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(errors="backslashreplace")
    return stream
