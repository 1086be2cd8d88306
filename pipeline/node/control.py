"""A node's end of the socket to its supervisor: lines in, events out, both private to the node.

The process is started with the socket as its standard input. It is moved to a descriptor of its own
that no program started by an operator inherits; whatever an operator does with its standard streams
then concerns its log alone.
"""

import contextlib
import json
import os
import select
import socket
import threading
from collections.abc import Iterator
from typing import Any

from pipeline.text import harmless

MOST_WORDS = 2000  # characters of a headline, an error, a reason; the log has them whole
MOST_LINE = 1 << 20  # bytes of one event: a summary that is longer is left out
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

    def say(self, event: str, **more: Any) -> None:
        """Tell the supervisor; words are bounded. Nothing happens when it has died.

        Raises `TypeError` or `ValueError` for figures that JSON does not know.
        """
        line = json.dumps({"event": event, **{k: _bounded(v) for k, v in more.items()}})
        if len(line) > MOST_LINE:
            left_out = f"expected up to {MOST_LINE} bytes, got {len(line)}"
            brief = {"event": event, "node": more.get("node"), "left_out": left_out}
            line = json.dumps({**brief, "figures": {}, "words": "", "error": left_out})
        with self._saying, contextlib.suppress(OSError):
            self._end.sendall(line.encode() + b"\n")

    def lines(self) -> Iterator[str]:
        """Yield what the supervisor sends, a line at a time, until it ends or dies."""
        with contextlib.suppress(OSError):
            while self._readable() and (data := self._end.recv(_CHUNK)):
                *whole, rest = data.split(b"\n")
                for line in whole:
                    complete, self._partial = self._partial + line, bytearray()
                    yield complete.decode(errors="replace")
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


def _bounded(value: Any) -> Any:
    return harmless(value, MOST_WORDS) if isinstance(value, str) else value
