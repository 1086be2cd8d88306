"""Supervisor's ends of the sockets to its nodes: nothing blocks, everything is bounded.

A node holds the other end (`pipeline.node.control`). Whatever a node, or a process that inherited
the socket from it, sends, it costs the supervisor at most a bounded buffer.
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

MOST_UNSENT = 8 << 20  # unread bytes (several plans); above it the node is deaf
MOST_LINE = 4 << 20  # bytes of one event
MOST_LINES_S = 100  # events per second and node, beyond a burst of as many; others are discarded
LEAST_ALLOWED = 25  # allowance at which a flooding node is read again
MOST_READ = 1 << 20  # bytes read from one node at a time
_CHUNK = 1 << 16


class Channel:
    """Instructions to a node and events from it, one per line."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._end = end
        self._unsent = bytearray()
        self._partial = bytearray()
        self._skipping = False  # discarding the rest of a line that was too long
        self._events: deque[Event] = deque(maxlen=2 * MOST_LINES_S)
        self._allowed, self._allowed_s = float(MOST_LINES_S), time.monotonic()
        self.left_out = 0  # discarded lines: too many, too long or no event
        self.deaf = False  # the node does not read its instructions
        self.ended = False  # the node's end is closed

    def fileno(self) -> int:
        """The descriptor, for a selector; -1 once closed."""
        return self._end.fileno()

    @property
    def unsent(self) -> bool:
        """Whether data waits until the node reads."""
        return bool(self._unsent)

    @property
    def flooded(self) -> bool:
        """Whether the node exceeds its rate of events and is not read for now."""
        if self._allowed == float("inf"):
            return False
        now_s = time.monotonic()
        earned = (now_s - self._allowed_s) * MOST_LINES_S
        self._allowed, self._allowed_s = min(self._allowed + earned, MOST_LINES_S), now_s
        return self._allowed < LEAST_ALLOWED

    def send(self, message: ControlMessage) -> None:
        """Send now or as soon as the node reads; nothing is sent to a deaf node."""
        data = as_line(encode(message))
        if self.deaf or len(self._unsent) + len(data) > MOST_UNSENT:
            self.deaf = True
            return
        self._unsent += data
        self.flush()

    def flush(self) -> None:
        """Send as much as the node accepts now."""
        while self._unsent:
            try:
                sent = self._end.send(self._unsent[:_CHUNK])
            except (BlockingIOError, InterruptedError):
                return
            except OSError:  # the node died, which is noticed elsewhere
                self._unsent.clear()
                return
            del self._unsent[:sent]

    def events(self) -> list[Event]:
        """Read available data and return its events."""
        self._receive()
        found = list(self._events)
        self._events.clear()
        return found

    def waiting(self) -> bool:
        """Whether an event is available without waiting."""
        self._receive()
        return bool(self._events)

    def close(self) -> None:
        """Read all available data, whatever its rate, and close the descriptor; events stay."""
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
            except OSError:  # reset: the node died with unread instructions
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
            event = decode(EVENT, from_line(line))
        except FoveaError:
            self.left_out += 1
            return
        self.left_out += len(self._events) == self._events.maxlen  # the oldest makes room
        self._events.append(event)


class Exchange:
    """The selector of a supervisor: waits for its nodes' channels and for wake-ups."""

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
        """Wait for a channel from now on, until it ends."""
        self._watched[channel.fileno()] = channel

    def remove(self, channel: Channel) -> None:
        """Stop waiting for a channel; call this before closing it."""
        if self._watched.pop(channel.fileno(), None) is channel:
            with contextlib.suppress(KeyError):
                self._selector.unregister(channel)

    def wake(self) -> None:
        """Make `wait` return at once; callable from any thread."""
        with contextlib.suppress(OSError):
            self._alarm.send(b"!")

    def wait(self, seconds: float) -> None:
        """Wait for an event, a call of `wake` or the timeout."""
        for channel in list(self._watched.values()):
            if channel.ended:
                self.remove(channel)  # otherwise its end would be readable for ever
                continue
            channel.flush()
            self._watch(channel)
        self._selector.select(seconds)
        with contextlib.suppress(OSError):
            while self._awake.recv(_CHUNK):
                pass

    def _watch(self, channel: Channel) -> None:
        """Select the readiness that matters now; none for a flooded channel."""
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
        """Close the descriptors."""
        self._watched.clear()
        self._selector.close()
        self._awake.close()
        self._alarm.close()
