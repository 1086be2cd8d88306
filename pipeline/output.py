"""Standard output and standard error of a command: a reader may leave, a terminal may vanish.

A command whose standard output is its answer ends then, quietly. One that keeps a graph running
loses words and nothing else (`forgive`), also where a reader stops reading.
"""

import io
import os
import select
import sys
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from typing_extensions import Buffer

PATIENCE_S = 0.1  # for a reader that does not read, once
_ATOMIC = 512  # bytes that a pipe which can be written takes without waiting (POSIX)


class Outlet(io.RawIOBase):
    """One of the two; what cannot be written any more is forgotten after the first error."""

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self.lost = self.forgiving = self._stuck = False

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
        """Write; raises `OSError` once, unless it forgives, when the reader has left."""
        view = memoryview(data).cast("B")
        try:
            if self.lost or (self.forgiving and not self._takes()):
                return view.nbytes
            return os.write(self._handle, view[:_ATOMIC] if self.forgiving else view)
        except BlockingIOError:  # another program has made the terminal so
            self._takes()
            return 0 if not self.forgiving else view.nbytes
        except OSError:
            self.lost = True
            if not self.forgiving:
                raise
            return view.nbytes

    def _takes(self) -> bool:
        """Whether the reader reads; one that did not is waited for no more, until it does."""
        poll = select.poll()
        poll.register(self._handle, select.POLLOUT)
        self._stuck = not poll.poll(0 if self._stuck else 1000 * PATIENCE_S)
        return not self._stuck


def guard() -> None:
    """Have both streams go through outlets; descriptors that are closed lead nowhere."""
    for handle in range(3):
        try:
            os.fstat(handle)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest that is free: this one
    sys.stdout = _guarded(sys.stdout, 1)
    sys.stderr = _guarded(sys.stderr, 2)


def forgive() -> None:
    """From now on let a stream that cannot be written cost its words alone."""
    for outlet in _outlets():
        outlet.forgiving = True


def lost() -> bool:
    """Whether a stream could not be written."""
    return any(outlet.lost for outlet in _outlets())


def _outlets() -> list[Outlet]:
    found = [getattr(getattr(s, "buffer", None), "raw", None) for s in (sys.stdout, sys.stderr)]
    return [outlet for outlet in found if isinstance(outlet, Outlet)]


def _guarded(stream: TextIO | None, handle: int) -> TextIO:
    if stream is not None and stream is not (sys.__stdout__ if handle == 1 else sys.__stderr__):
        return stream  # guarded already, or replaced by the caller
    if stream is not None:
        stream.flush()
    outlet = Outlet(handle)
    encoding = stream.encoding if stream is not None else "utf-8"
    return io.TextIOWrapper(
        io.BufferedWriter(outlet), encoding, errors="backslashreplace",
        line_buffering=handle == 2 or outlet.isatty(),
    )  # fmt: skip
