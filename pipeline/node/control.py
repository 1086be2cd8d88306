"""Node's end of the socket to its supervisor: instructions in, events out.

The process is started with the socket as its standard input. The socket is then moved to another
descriptor, which is not inherited by programs that an operator starts. Operators may do anything
with the standard streams: that affects only their log.
"""

import contextlib
import os
import select
import socket
import threading
from collections.abc import Iterator

import msgspec

from pipeline.protocol.codec import decode, encode
from pipeline.protocol.lines import as_line, from_line
from pipeline.protocol.supervision import INSTRUCTION, Event, Instruction
from pipeline.text import harmless

MOST_WORDS = 2000  # characters of a headline, an error or a reason; the log has the whole text
LOOK_S = 1.0  # interval of checks whether the supervisor lives
_CHUNK = 1 << 16


class Control:
    """Reads instructions from the supervisor and sends it events."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._parent = os.getppid()
        self._partial = bytearray()
        self._saying = threading.Lock()
        self.alone = False  # the supervisor has died

    @classmethod
    def from_standard_input(cls) -> "Control":
        """Take the socket from standard input, which is empty afterwards."""
        control = cls(socket.socket(fileno=os.dup(0)))
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        return control

    def say(self, event: Event) -> None:
        """Send an event to the supervisor, with texts truncated; no effect when it has died.

        Raises `MessageError` for figures without encoding.
        """
        line = as_line(encode(_bounded(event)))
        with self._saying, contextlib.suppress(OSError):
            self._end.sendall(line)

    def instructions(self) -> Iterator[Instruction]:
        """Yield the supervisor's instructions until it closes the socket or dies."""
        with contextlib.suppress(OSError):
            while self._readable() and (data := self._end.recv(_CHUNK)):
                *whole, rest = data.split(b"\n")
                for line in whole:
                    complete, self._partial = self._partial + line, bytearray()
                    yield decode(INSTRUCTION, from_line(bytes(complete)))
                self._partial += rest
        self.alone = True

    def _readable(self) -> bool:
        """Wait for data; return False when the supervisor died, even if its end is held open."""
        poll = select.poll()
        poll.register(self._end, select.POLLIN)
        while not poll.poll(1000 * LOOK_S):
            if os.getppid() != self._parent:
                return False
        return True


def _bounded(event: Event) -> Event:
    """Return the event with sanitised, truncated texts."""
    texts = {k: v for k in event.__struct_fields__ if isinstance(v := getattr(event, k), str)}
    return msgspec.structs.replace(event, **{k: harmless(v, MOST_WORDS) for k, v in texts.items()})
