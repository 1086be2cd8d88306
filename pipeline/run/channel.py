"""The supervisor's ends of the sockets to its nodes: nothing blocks, everything is bounded.

A node holds the other end (`pipeline.node.control`). What a node does with it, or a process that it
started and that inherited it, costs the supervisor a bounded buffer and nothing else.
"""

import contextlib
import selectors
import socket
import time
from collections import deque

from pipeline.errors import FoveaError
from pipeline.protocol.codec import ControlMessage, decode, encode
from pipeline.protocol.lines import as_line, from_line
from pipeline.protocol.supervision import EVENT, Event

MOST_UNSENT = 8 << 20  # bytes that a node has not read: several plans; more and it is deaf
MOST_LINE = 4 << 20  # bytes of one event
MOST_LINES_S = 100  # events a second and node, beyond a burst of as many; more is left out
LEAST_ALLOWED = 25  # of them before a node that said too many is listened to again
MOST_READ = 1 << 20  # bytes of one node in one look
_CHUNK = 1 << 16


class Channel:
    """Instructions to a node, events from it, each on a line of its own."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._end = end
        self._unsent = bytearray()
        self._partial = bytearray()
        self._skipping = False  # the rest of a line that was too long
        self._events: deque[Event] = deque(maxlen=2 * MOST_LINES_S)
        self._allowed, self._allowed_s = float(MOST_LINES_S), time.monotonic()
        self.left_out = 0  # lines that were too many, too long or no event
        self.deaf = False  # the node does not read what it is sent
        self.ended = False  # nothing more will come

    def fileno(self) -> int:
        """The descriptor, for a selector; -1 once closed."""
        return self._end.fileno()

    @property
    def unsent(self) -> bool:
        """Whether something waits until the node reads."""
        return bool(self._unsent)

    @property
    def flooded(self) -> bool:
        """Whether the node says so much that it has to wait until it is heard again."""
        now_s = time.monotonic()
        earned = (now_s - self._allowed_s) * MOST_LINES_S
        self._allowed, self._allowed_s = min(self._allowed + earned, MOST_LINES_S), now_s
        return self._allowed < LEAST_ALLOWED

    def send(self, message: ControlMessage) -> None:
        """Send it, at once or as soon as the node reads; a deaf node is sent nothing more."""
        data = as_line(encode(message))
        if self.deaf or len(self._unsent) + len(data) > MOST_UNSENT:
            self.deaf = True
            return
        self._unsent += data
        self.flush()

    def flush(self) -> None:
        """Send as much as the node takes now."""
        while self._unsent:
            try:
                sent = self._end.send(self._unsent[:_CHUNK])
            except (BlockingIOError, InterruptedError):
                return
            except OSError:  # it died: its end is noticed elsewhere
                self._unsent.clear()
                return
            del self._unsent[:sent]

    def events(self) -> list[Event]:
        """Read what has come and return the events in it."""
        self._receive()
        found = list(self._events)
        self._events.clear()
        return found

    def waiting(self) -> bool:
        """Whether an event can be had without waiting."""
        self._receive()
        return bool(self._events)

    def close(self) -> None:
        """Read what is there, whatever its rate, and give the descriptor back; events stay."""
        self._allowed = float("inf")
        self._receive()
        self.ended = True
        self._unsent.clear()
        self._end.close()

    def _receive(self) -> None:
        for _ in range(MOST_READ // _CHUNK):
            if self.ended or self.flooded:
                return
            try:
                data = self._end.recv(_CHUNK)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:  # reset: it died with lines unread
                data = b""
            if not data:
                self.ended = True
                return
            self._take(data)

    def _take(self, data: bytes) -> None:
        *whole, rest = data.split(b"\n")
        for line in whole:
            if self._skipping or len(self._partial) + len(line) > MOST_LINE or self._allowed < 1:
                self.left_out += 1
            else:
                self._understand(bytes(self._partial) + line)
            self._partial.clear()
            self._skipping = False
        self._partial += rest
        if len(self._partial) > MOST_LINE:
            self._partial.clear()
            self._skipping = True

    def _understand(self, line: bytes) -> None:
        self._allowed -= 1
        try:
            self._events.append(decode(EVENT, from_line(line)))
        except FoveaError:
            self.left_out += 1


class Exchange:
    """What a supervisor waits for between two ticks: its nodes' channels and wake-ups."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        try:
            self._awake, self._alarm = socket.socketpair()
        except OSError:
            self._selector.close()
            raise
        for end in (self._awake, self._alarm):
            end.setblocking(False)
        self._selector.register(self._awake, selectors.EVENT_READ)
        self._watched: dict[int, Channel] = {}

    def add(self, channel: Channel) -> None:
        """Wake up for a channel from now on, until it ends."""
        self._watched[channel.fileno()] = channel

    def remove(self, channel: Channel) -> None:
        """Wake up for it no more; to be called before it is closed."""
        if self._watched.pop(channel.fileno(), None) is channel:
            with contextlib.suppress(KeyError):
                self._selector.unregister(channel)

    def wake(self) -> None:
        """Let `wait` return at once; any thread may call it."""
        with contextlib.suppress(OSError):
            self._alarm.send(b"!")

    def wait(self, seconds: float) -> None:
        """Wait until a node says something, somebody wakes, or the time is over."""
        for channel in list(self._watched.values()):
            if channel.ended:
                self.remove(channel)  # its end is readable for ever
                continue
            channel.flush()
            self._watch(channel)
        self._selector.select(seconds)
        with contextlib.suppress(OSError):
            while self._awake.recv(_CHUNK):
                pass

    def _watch(self, channel: Channel) -> None:
        """Have the selector look at what matters now; of a flooded channel, at nothing."""
        reads = 0 if channel.flooded else selectors.EVENT_READ
        events = reads | (selectors.EVENT_WRITE if channel.unsent else 0)
        known = self._selector.get_map().get(channel)
        if known is None and events:
            self._selector.register(channel, events)
        elif known is not None and not events:
            self._selector.unregister(channel)
        elif known is not None and known.events != events:
            self._selector.modify(channel, events)

    def close(self) -> None:
        """Give the descriptors back."""
        self._watched.clear()
        self._selector.close()
        self._awake.close()
        self._alarm.close()
