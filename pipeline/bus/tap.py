"""Hears an output from outside the graph: descriptors in, headers and small values out.

A tap has no account in the graph and never looks into the frame pool: big arrays are told by their
type and shape alone. So it cannot hold a slot, whatever becomes of it, and a slot that is written
anew costs it nothing. What it misses it counts: every message has a number.
"""

import queue
import threading
import time
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline import codec
from pipeline.bus.envelope import HANDSHAKE, NOTHING, Envelope, first_of
from pipeline.errors import MessageError
from pipeline.fields import Fetch
from pipeline.messages import Header, Message

ROOM = 4096  # descriptors that may wait for a terminal


class Reader(Protocol):
    """Reads the messages of one schema."""

    @property
    def fingerprint(self) -> bytes:
        """Of the schema."""
        ...

    def read(self, data: codec.Buffer, fetch: Fetch) -> Any:
        """A message, which has a `header`; raises `MessageError`."""
        ...


class Heard(NamedTuple):
    """What an output sent for one exposure."""

    at_ns: int  # monotonic, when it came
    header: Header
    message: Any  # what the reader gave; big arrays are zeros; None: it had nothing to say
    after_loss: bool  # whether something was missed just before it


class Missed(NamedTuple):
    """How many messages a tap did not get, by reason."""

    on_the_way: int = 0  # the bus dropped them, or they died with their node
    slow: int = 0  # the tap's own reader did not come for them
    refused: int = 0  # not of the schema that the tap expects

    def __str__(self) -> str:
        """The reasons in words.

        >>> str(Missed(on_the_way=2, slow=1)), str(Missed())
        ('missed 3: 2 lost on the way, 1 not read in time', '')
        """
        words = ("lost on the way", "not read in time", "of another schema")
        reasons = [f"{count} {word}" for count, word in zip(self, words, strict=True) if count]
        return f"missed {sum(self)}: {', '.join(reasons)}" if reasons else ""

    def since(self, earlier: "Missed") -> "Missed":
        """What was missed after an earlier count."""
        return Missed(*(b - a for a, b in zip(earlier, self, strict=True)))


@dataclass
class _Instance:
    """What came of one instance of the node: the first number it used, the last, how many."""

    first: int
    last: int
    heard: int = 0


class Tap:
    """`receive` is called by the transport's thread, everything else by one other."""

    def __init__(self, message: type[Message] | Reader, room: int = ROOM) -> None:
        """Messages of a class, or of what reads them without one."""
        self._schema: Reader = codec.schema(message) if isinstance(message, type) else message
        self._fingerprint = self._schema.fingerprint
        self._waiting: queue.Queue[tuple[int, Envelope, bool]] = queue.Queue(room)
        self._lock = threading.Lock()
        self._instances: dict[int, _Instance] = {}  # by epoch
        self._slow = self._refused = 0
        self.skipped = 0  # of what came by way of a relay: for want of room there
        self._after_loss = False  # something was missed since the last one that was kept

    def receive(self, payload: bytes, at_ns: int = 0) -> None:
        """Take one descriptor, which came now or `at_ns`; never raises, never waits."""
        at_ns = at_ns or time.monotonic_ns()
        try:
            envelope = Envelope.parse(payload)
        except MessageError:
            return  # without a number it is no message of the output
        with self._lock:
            if not self._count(envelope):
                return
            if envelope.fingerprint != self._fingerprint:
                self._refused += 1
                self._after_loss = True
                return
            try:
                self._waiting.put_nowait((at_ns, envelope, self._after_loss))
                self._after_loss = False
            except queue.Full:
                self._slow += 1
                self._after_loss = True

    def next(self, timeout_s: float) -> Heard | None:
        """The next exposure; None when nothing came in time."""
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                left_s = max(0.0, deadline - time.monotonic())
                at_ns, envelope, after_loss = self._waiting.get(timeout=left_s)
            except queue.Empty:
                return None
            try:
                return Heard(at_ns, *self._read(envelope), after_loss)
            except MessageError:
                self._refused += 1

    @property
    def missed(self) -> Missed:
        """What did not come since the first descriptor that did."""
        with self._lock:
            instances = sorted(self._instances.items())
            lost = sum(max(0, i.last - i.first + 1 - i.heard) for _, i in instances)
            for (_, before), (epoch, after) in pairwise(instances):
                if after.first < first_of(epoch):  # it goes on with its predecessor's numbers
                    lost += max(0, after.first - before.last - 1)
            skipped = min(lost, self.skipped)
            return Missed(lost - skipped, self._slow + skipped, self._refused)

    @property
    def instances(self) -> int:
        """How many instances of the node were heard."""
        return len(self._instances)

    def _count(self, envelope: Envelope) -> bool:
        """Whether it is a message of the instance that spoke for the node when it was sent."""
        epoch, ordinal, handshake = envelope.epoch, envelope.ordinal, envelope.kind == HANDSHAKE
        known = self._instances.get(epoch)
        if known is None:
            if any(other > epoch for other in self._instances):
                return False  # not heard while it spoke
            first = ordinal + handshake
            if self._instances and first > first_of(epoch):
                first = first_of(epoch)  # it counts anew, and this is not its first
            known = self._instances[epoch] = _Instance(first, first - 1)
        later = [i.first for e, i in self._instances.items() if e > epoch]
        if later and min(later) <= ordinal:
            return False  # its successor had taken over by then
        if ordinal > known.last + 1:
            self._after_loss = True
        known.last = max(known.last, ordinal)
        known.heard += not handshake
        return not handshake

    def _read(self, envelope: Envelope) -> tuple[Header, Any]:
        if envelope.kind == NOTHING:
            return codec.unpack(Header, envelope.body), None
        slot_bytes = envelope.slot.nbytes if envelope.slot else 0

        def blank(offset: int, nbytes: int) -> NDArray[np.uint8]:
            if offset + nbytes > slot_bytes:
                raise MessageError(f"an array ends at {offset + nbytes} of {slot_bytes} bytes")
            return np.zeros(nbytes, np.uint8)  # memory that nobody touches costs nothing

        message = self._schema.read(envelope.body, blank)
        return message.header, message
