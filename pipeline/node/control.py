"""A node's end of the socket to its supervisor: instructions in, events out.

The process is started with the socket as its standard input. It is moved to a descriptor of its own
that no program started by an operator inherits; whatever an operator does with its standard streams
then concerns its log alone.
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

MOST_WORDS = 2000  # characters of a headline, an error, a reason; the log has them whole
LOOK_S = 1.0  # between two looks whether the supervisor lives
_CHUNK = 1 << 16


class Control:
    """Reads what the supervisor orders, tells it what happens."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._parent = os.getppid()
        self._partial = bytearray()
        self._saying = threading.Lock()
        self.alone = False  # the supervisor has died

    @classmethod
    def from_standard_input(cls) -> "Control":
        """Take the socket over and leave an empty standard input."""
        control = cls(socket.socket(fileno=os.dup(0)))
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        return control

    def say(self, event: Event) -> None:
        """Tell the supervisor; words are bounded. Nothing happens when it has died.

        Raises `MessageError` for figures that cannot travel.
        """
        line = as_line(encode(_bounded(event)))
        with self._saying, contextlib.suppress(OSError):
            self._end.sendall(line)

    def instructions(self) -> Iterator[Instruction]:
        """Yield what the supervisor sends until it ends or dies."""
        with contextlib.suppress(OSError):
            while self._readable() and (data := self._end.recv(_CHUNK)):
                *whole, rest = data.split(b"\n")
                for line in whole:
                    complete, self._partial = self._partial + line, bytearray()
                    yield decode(INSTRUCTION, from_line(bytes(complete)))
                self._partial += rest
        self.alone = True

    def _readable(self) -> bool:
        """Wait for data; False when the supervisor died, even if its end is held open."""
        poll = select.poll()
        poll.register(self._end, select.POLLIN)
        while not poll.poll(1000 * LOOK_S):
            if os.getppid() != self._parent:
                return False
        return True


def _bounded(event: Event) -> Event:
    """The event with its texts cut to a length and in printable characters."""
    texts = {k: v for k in event.__struct_fields__ if isinstance(v := getattr(event, k), str)}
    return msgspec.structs.replace(event, **{k: harmless(v, MOST_WORDS) for k, v in texts.items()})
