"""Listen to an output from outside the graph: descriptors in, headers and small values out.

A tap has no account in the graph and never reads the frame pool: of large arrays it reports only
dtype and shape. So it can neither hold a slot nor lose a message because a slot was reused. It
counts the messages that it misses, since every message has an ordinal.
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

ROOM = 4096  # queued descriptors, while a terminal is slow


class Reader(Protocol):
    """Reads the messages of one schema."""

    @property
    def fingerprint(self) -> bytes:
        """Return the fingerprint of the schema."""
        ...

    def read(self, data: codec.Buffer, fetch: Fetch) -> Any:
        """Decode a message, which has a `header`; raises `MessageError`."""
        ...


class Heard(NamedTuple):
    """What an output sent for one exposure."""

    at_ns: int  # monotonic time of arrival
    header: Header
    message: Any  # from the reader, large arrays as zeros; None: no message for this exposure
    after_loss: bool  # whether messages were missed just before it


class Missed(NamedTuple):
    """Number of messages that a tap did not get, by reason."""

    on_the_way: int = 0  # dropped by the bus, or lost with their node
    slow: int = 0  # the tap's user did not fetch them in time
    refused: int = 0  # not of the expected schema

    def __str__(self) -> str:
        """Return the counts and reasons as text.

        >>> str(Missed(on_the_way=2, slow=1)), str(Missed())
        ('missed 3: 2 lost on the way, 1 not read in time', '')
        """
        words = ("lost on the way", "not read in time", "of another schema")
        reasons = [f"{count} {word}" for count, word in zip(self, words, strict=True) if count]
        return f"missed {sum(self)}: {', '.join(reasons)}" if reasons else ""

    def since(self, earlier: "Missed") -> "Missed":
        """Return the difference to an earlier count."""
        return Missed(*(b - a for a, b in zip(earlier, self, strict=True)))


@dataclass
class _Instance:
    """Arrivals from one instance of the node: first ordinal, last ordinal, count."""

    first: int
    last: int
    heard: int = 0


class Tap:
    """A tap; the transport's thread calls `receive`, one other thread everything else."""

    def __init__(self, message: type[Message] | Reader, room: int = ROOM) -> None:
        """`message`: the class of the messages, or a reader that needs no class."""
        self._schema: Reader = codec.schema(message) if isinstance(message, type) else message
        self._fingerprint = self._schema.fingerprint
        self._waiting: queue.Queue[tuple[int, Envelope, bool]] = queue.Queue(room)
        self._lock = threading.Lock()
        self._instances: dict[int, _Instance] = {}  # by epoch
        self._slow = self._refused = 0
        self.skipped = 0  # messages that a relay skipped for lack of room
        self._after_loss = False  # messages were missed since the last one kept

    def receive(self, payload: bytes, at_ns: int = 0) -> None:
        """Receive one descriptor, arrived now or at `at_ns`; never raises or waits."""
        at_ns = at_ns or time.monotonic_ns()
        try:
            envelope = Envelope.parse(payload)
        except MessageError:
            return  # without an ordinal it is no message
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
        """Return the next exposure; None after the timeout."""
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
        """Return the messages missed since the first descriptor."""
        with self._lock:
            instances = sorted(self._instances.items())
            lost = sum(max(0, i.last - i.first + 1 - i.heard) for _, i in instances)
            for (_, before), (epoch, after) in pairwise(instances):
                if after.first < first_of(epoch):  # it continues its predecessor's ordinals
                    lost += max(0, after.first - before.last - 1)
            skipped = min(lost, self.skipped)
            return Missed(lost - skipped, self._slow + skipped, self._refused)

    @property
    def instances(self) -> int:
        """Return the number of instances that were heard."""
        return len(self._instances)

    def _count(self, envelope: Envelope) -> bool:
        """Count an envelope; return whether its instance was the active one when it was sent."""
        epoch, ordinal, handshake = envelope.epoch, envelope.ordinal, envelope.kind == HANDSHAKE
        known = self._instances.get(epoch)
        if known is None:
            if any(other > epoch for other in self._instances):
                return False  # not heard while it was active
            first = ordinal + handshake
            if self._instances and first > first_of(epoch):
                first = first_of(epoch)  # new ordinals, and this is not the first
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
            try:
                return np.zeros(nbytes, np.uint8)  # untouched memory costs nothing
            except (MemoryError, ValueError) as error:
                raise MessageError(f"an array of {nbytes} bytes") from error

        message = self._schema.read(envelope.body, blank)
        return message.header, message
