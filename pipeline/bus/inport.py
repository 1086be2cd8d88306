"""Reading end of an edge: descriptors in, messages out, each one accounted for."""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pipeline import codec
from pipeline.bus.envelope import GOES_ON, HANDSHAKE, LOST, NOTHING, Envelope
from pipeline.bus.envelope_buffer import DropCounts, EdgeCut, EnvelopeBuffer
from pipeline.bus.ledger import DROPS, EdgeAccount, private_ledger
from pipeline.bus.outport import Arrival
from pipeline.bus.pool import PoolReader
from pipeline.errors import MessageError
from pipeline.messages import Header, Message

TAP_SLOTS = 2  # slots that a viewer may pin before it copies


class InPort:
    """One input of a node: accounts for all arrivals and passes on the valid ones.

    `receive` is called by one thread at a time. While `holding`, descriptors are only buffered:
    another instance runs for this node, and this one may have to continue where it stops.
    """

    def __init__(
        self, message: type[Message], account: EdgeAccount, pool: PoolReader, epoch: int,
        deliver: Callable[[Arrival], None], *, tap: bool = False, holding: bool = False,
    ) -> None:  # fmt: skip
        self._message, self._account, self._pool = message, account, pool
        self._schema = codec.schema(message)
        self._epoch, self._deliver, self._tap = epoch, deliver, tap
        self._sender_epoch, self._fingerprint = -1, self._schema.fingerprint
        self._seen = max(account.seen, account.accounted)
        self._open: set[int] = set()  # delivered here, not yet finished
        self._careful = False
        self._buffer: EnvelopeBuffer | None = None
        self.also: Callable[[Envelope], None] | None = None  # of a shadow, while holding
        self.on_loss: Callable[[], None] = lambda: None  # called when frames in flight were lost
        if holding:
            self._buffer = EnvelopeBuffer()
        else:  # messages that the predecessor had not finished are lost
            account.lost_in_crash += max(0, account.seen - account.accounted)

    @property
    def buffer(self) -> EnvelopeBuffer | None:
        """The buffered envelopes, while holding."""
        return self._buffer

    @property
    def dropped(self) -> int:
        """Number of messages dropped here or lost on their way."""
        return sum(self._account.dropped(name) for name in DROPS) + self._account.lost_in_crash

    def receive(self, payload: bytes) -> None:
        """Receive one descriptor; never raises."""
        try:
            envelope = Envelope.parse(payload)
        except MessageError:
            if self._buffer is None:
                self._account.unexpected += 1  # without an ordinal it belongs to no edge
            return
        envelope.ordinal -= self._account.base
        if self._buffer is None:
            self._receive(envelope)
        else:
            self._buffer.add(envelope)
            if self.also is not None:
                self.also(envelope)

    def divert(self, deliver: Callable[[Arrival], None]) -> None:
        """Deliver everything to another callable from now on."""
        self._deliver = deliver

    def shadow(self, deliver: Callable[[Arrival], None]) -> "InPort":
        """Return a port for a shadow run: it gets what this one holds and has its own account."""
        port = InPort(
            self._message, private_ledger(1, 0).edges[0], self._pool, self._epoch, deliver,
            tap=True, holding=True,
        )  # fmt: skip
        assert port._buffer is not None
        assert self._buffer is not None
        port._buffer.envelopes.extend(self._buffer.envelopes)
        self.also = port._receive
        return port

    def finished(self, ordinal: int) -> None:
        """Mark a delivered message as finished."""
        self._open.discard(ordinal)
        if self._careful:
            self._tell_seen()

    def finished_up_to(self, ordinal: int) -> bool:
        """Whether every message up to an ordinal has arrived and is finished."""
        return self._seen >= ordinal and all(o > ordinal for o in self._open)

    def cut(self) -> EdgeCut:
        """Start holding; return where the successor has to begin."""
        self._buffer, self._careful = EnvelopeBuffer(self._seen), True
        self._tell_seen()
        return self.here()

    def here(self) -> EdgeCut:
        """Return the current position."""
        return EdgeCut(self._seen, sorted(self._open), self._sender_epoch)

    def take_over(self, cut: EdgeCut) -> None:
        """Continue where another instance stopped, with its unfinished messages and later ones.

        Until `confirm`, a message counts as seen only when it is finished, so that its memory is
        still there for the other instance if this one fails.
        """
        buffer, self._buffer = self._buffer or EnvelopeBuffer(), None
        self._seen, self._sender_epoch, self._careful = cut.seen, cut.sender_epoch, True
        self._account.attached_epoch = self._epoch
        unfinished = set(cut.unfinished)
        for envelope in buffer.envelopes:
            if envelope.ordinal >= cut.seen + (envelope.kind != HANDSHAKE):
                self._receive(envelope)
            elif envelope.ordinal in unfinished:
                self._hand_on(envelope)
        self._tell_seen()

    def confirm(self) -> None:
        """End the probation of this instance: messages count as seen when they arrive."""
        self._careful = False
        self._tell_seen()

    def resume(self, epoch: int, before: DropCounts) -> Callable[[int], bool]:
        """Continue after a successor has failed; return a test for ordinals that it had finished.

        Its drops beyond the last message that it finished are decided again, and not counted
        twice. The caller makes its inbox forget finished messages, then replays the buffer.
        """
        account, done = self._account, self._account.seen
        buffer = self._buffer or EnvelopeBuffer()
        self._epoch = account.attached_epoch = epoch
        again = {o for o in self._open if o > done}
        again |= {e.ordinal for e in buffer.envelopes if e.ordinal > done and e.kind != HANDSHAKE}
        newest = max([done, self._seen, *again])
        before.refund(account, account.accounted - (newest - len(again)))
        self._open = {o for o in self._open if o > done}
        self._seen, self._careful = max(self._seen, done), False
        return lambda ordinal: ordinal <= done

    def replay(self) -> None:
        """Receive the buffered envelopes."""
        buffer, self._buffer = self._buffer or EnvelopeBuffer(), None
        for envelope in buffer.envelopes:
            if envelope.ordinal >= self._seen + (envelope.kind != HANDSHAKE):
                self._receive(envelope)
        self._tell_seen()

    def _receive(self, envelope: Envelope) -> None:
        account = self._account
        fresh = account.attached_epoch != self._epoch or envelope.epoch != self._sender_epoch
        missing = envelope.ordinal - self._seen - (envelope.kind != HANDSHAKE)
        if missing < 0:
            account.unexpected += 1
            return
        self._seen = envelope.ordinal
        if missing:
            account.acknowledge("lost_in_crash" if fresh else "gap", missing)
        if fresh:
            self._sender_epoch = envelope.epoch
            account.attached_epoch = self._epoch
        if missing or (envelope.kind == HANDSHAKE and _tells_loss(envelope, fresh=fresh)):
            self.on_loss()
        self._hand_on(envelope)
        self._tell_seen()

    def _hand_on(self, envelope: Envelope) -> None:
        arrival, outcome = self._read(envelope)
        if arrival is not None:
            self._open.add(envelope.ordinal)
            self._deliver(arrival)
        elif outcome:
            self._account.acknowledge(outcome)

    def _tell_seen(self) -> None:
        careful = self._careful and self._open
        self._account.seen = min(self._open) - 1 if careful else self._seen

    def _read(self, envelope: Envelope) -> tuple[Arrival | None, str]:
        """Return the arrival, or None with the reason of the drop (empty for a handshake)."""
        if envelope.kind == HANDSHAKE:
            return None, ""
        if envelope.epoch < self._account.writer_epoch:
            return None, "fenced"
        if envelope.fingerprint != self._fingerprint:
            return None, "refused"
        try:
            if envelope.kind == NOTHING:
                header = codec.unpack(Header, envelope.body)
                return Arrival(header, None, envelope.ordinal), ""
            fetch = codec.nowhere
            if envelope.slot is not None:
                raw = self._pool.take(envelope.slot)
                if raw is None:
                    return None, "overwritten"
                fetch = partial(_cut, self._affordable(raw))
            message = self._schema.read(envelope.body, fetch)
        except MessageError:
            return None, "refused"
        return Arrival(message.header, message, envelope.ordinal), ""

    def _affordable(self, raw: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the memory, copied if a viewer would otherwise pin more than `TAP_SLOTS`."""
        if self._tap and self._pool.pinned > TAP_SLOTS:
            raw = raw.copy()
            raw.flags.writeable = False
        return raw


def _tells_loss(handshake: Envelope, *, fresh: bool) -> bool:
    """Whether a handshake means a loss: a dead predecessor had frames in hand, a live one not."""
    said = bytes(handshake.body)
    return said == LOST or (fresh and said != GOES_ON)


def _cut(raw: NDArray[np.uint8], offset: int, nbytes: int) -> NDArray[np.uint8]:
    if offset + nbytes > raw.nbytes:
        raise MessageError(f"an array ends at {offset + nbytes} of {raw.nbytes} bytes")
    return raw[offset : offset + nbytes]
