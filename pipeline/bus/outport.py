"""Writing end of an output: messages in, descriptors out.

Large arrays go through the frame pool, small ones inside the descriptor. Readers in the graph on
this host get descriptors by `local_transport`, taps by the output's Zenoh key, and subscribers on
other hosts get complete messages by a second key; the keys are used only while somebody subscribes.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline import codec
from pipeline.bus.envelope import HANDSHAKE, MESSAGE, NOTHING, Envelope, first_of
from pipeline.bus.ledger import EdgeAccount
from pipeline.bus.local_transport import LocalSender, Target
from pipeline.bus.pool import ALIGN_BYTES, DONE, KEPT, SPARE, Lease, PoolWriter, SlotRef
from pipeline.bus.session import Sender
from pipeline.errors import MessageError, PoolExhausted
from pipeline.messages import Header, Message

INLINE_BYTES = 8192  # arrays up to this size are sent inside the descriptor
MOST_PACKET_BYTES = 160 << 10  # below what a socket takes as one packet where nothing is tuned
INSIST_S = 5.0  # by then a frozen reader has been replaced
PROBE_S = 0.5  # a reader without credit for this long may be waiting for a lost message
MOST_AHEAD = 2  # of the exposure in hand and of the next one
BYTES_SUFFIX = "/bytes"  # suffix of the key with complete messages


class Arrival(NamedTuple):
    """An arrival at an input: a message, or the notice that this exposure has none."""

    header: Header
    message: Message | None
    ordinal: int


@dataclass(frozen=True)
class Reader:
    """An edge as its writer sees it."""

    account: EdgeAccount
    lossless: bool
    depth: int
    edge: int = 0
    address: Callable[[int], Path] | None = None  # of its receiver; None: on another host

    def targets(self, instance: int) -> list[Target]:
        """Return the target of an instance, if it listens."""
        return [(self.edge, self.address(instance))] if self.address and instance else []

    def has_credit(self) -> bool:
        """Whether the reader has room for one more message; True for a reader that is gone."""
        account = self.account
        return not self.lossless or account.in_flight < self.depth or not account.live

    def claim(self, ordinal: int, newest: int) -> int:
        """Return its claim on a message: KEPT, SPARE or DONE."""
        account = self.account
        if not account.live:
            return SPARE if account.reader_epoch else DONE
        if account.base + account.seen >= ordinal:
            return DONE
        return SPARE if not self.lossless and newest >= ordinal + 2 else KEPT


class OutPort:
    """One output of a node."""

    def __init__(
        self, message: type[Message], sender: LocalSender, taps: Sender, remote: Sender,
        readers: Sequence[Reader], pool: Callable[[Callable[[int], int]], PoolWriter], epoch: int,
    ) -> None:  # fmt: skip
        self._message, self._sender = message, sender
        self._taps, self._remote = taps, remote
        self.readers = tuple(readers)
        self._epoch = epoch
        self._ordinal = self._counted()
        self._schema = codec.schema(message)
        self._fingerprint = self._schema.fingerprint
        self._pool = pool(self._claim)
        self._leases: list[Lease] = []
        self._ahead: list[Lease] = []  # lent beyond a call of a handler, oldest first
        self._receivers = [(0, 0)] * len(self.readers)  # per reader: the instances that listen
        self._goes_on: bool | None = None  # True: continues a live predecessor, without a loss
        self._lost = False
        self._no_credit_since_s = 0.0  # start of the wait for credit, or time of the last probe

    def begin(self, epoch: int) -> None:
        """Start sending for the node, after its predecessor's last message."""
        self._epoch, self._goes_on = epoch, True
        self._ordinal = self._counted()
        self._receivers = [(0, 0)] * len(self.readers)
        self._sender.set_targets(())  # a reader reads its newest link last
        self._pool.refresh()
        self.handshake()

    def change_readers(self, readers: Sequence[Reader], slots: int) -> None:
        """Change the readers from the next message on; the remaining ones are not affected."""
        known = {id(r.account) for r in self.readers}
        for reader in readers:
            if id(reader.account) not in known:
                reader.account.base = self._ordinal
        self.readers = tuple(readers)
        self._set_targets(
            [(r.account.receiver_epoch, r.account.next_receiver_epoch) for r in self.readers]
        )
        self._pool.resize(slots)
        self.handshake()

    @property
    def newest(self) -> int:
        """The ordinal of the latest message that was sent."""
        return self._ordinal

    def let_go(self) -> None:
        """While another instance sends: release the slots that no reader needs any more."""
        self._pool.let_go()

    def loan(
        self, shape: tuple[int, ...], dtype: DTypeLike, *, ahead: bool = False
    ) -> NDArray[Any]:
        """Return pool memory for an array of the next message; raises `PoolExhausted`.

        With `ahead` for one of the next two: a slot of its own, which `discard` does not release.
        """
        nbytes = math.prod(shape) * np.dtype(dtype).itemsize
        if nbytes <= INLINE_BYTES:
            return np.empty(shape, dtype)
        for lease in () if ahead else self._leases:
            array = lease.array(shape, dtype)
            if array is not None:
                return array
        if ahead and len(self._ahead) == MOST_AHEAD:
            raise PoolExhausted(f"{self._message.__name__}: {MOST_AHEAD} slots are lent ahead")
        lease = self._pool.lease(nbytes)
        (self._ahead if ahead else self._leases).append(lease)
        array = lease.array(shape, dtype)
        if array is None:
            raise PoolExhausted(f"{self._message.__name__}: slot of {nbytes} bytes is too small")
        return array

    def has_credit(self) -> bool:
        """Whether every lossless reader has room for one more message."""
        for reader in self.readers:  # noqa: SIM110 - a hot path: no generator
            if not reader.has_credit():
                return False
        return True

    def handshake(self) -> bool:
        """Send a handshake to readers without one; return whether all live ones have had it.

        A reader without credit is also probed with one at intervals: it contains the number of
        messages sent.
        """
        waiting = [r for r in self.readers if r.account.reader_epoch and not r.account.live]
        receivers = [
            (r.account.receiver_epoch, r.account.next_receiver_epoch) for r in self.readers
        ]
        if receivers != self._receivers:
            self._set_targets(receivers)
        lost, self._lost = self._lost, False
        if self._sender.connect() or waiting or self._probe_due() or lost:
            self._send(self._wrap(HANDSHAKE, None, False if lost else self._goes_on), ())
        return not waiting

    def has_lost(self) -> None:
        """Announce a loss of frames with the next handshake; callable from any thread."""
        self._lost = True

    def send(self, message: Message | None, header: Header) -> None:
        """Publish a message, or with None the notice that this exposure has none.

        Raises `PoolExhausted`, when no slot is free, and `MessageError` for a message that no
        reader on this host could receive, before anything is counted.
        """
        for reader in self.readers:
            if reader.account.writer_epoch > self._epoch:
                return  # a successor sends for this node now
        if message is None:
            self.discard()
            self._count()
            self._send(self._wrap(NOTHING, None, header), ())
            return
        if type(message) is not self._message:
            raise MessageError(
                f"expected {self._message.__name__} to send, got {type(message).__name__}"
            )
        lease = self._room_for(message)
        try:
            body = self._schema.write(message, partial(_place, lease))
        except MessageError:
            self.discard()
            raise
        if lease is not None:
            (self._leases if lease in self._leases else self._ahead).remove(lease)
            self._pool.publish(lease, self._ordinal + 1)
        self.discard()  # loans of this handler call that no message used
        payload = self._wrap(MESSAGE, lease.ref() if lease else None, body, self._ordinal + 1)
        if len(payload) > MOST_PACKET_BYTES and any(reader.address for reader in self.readers):
            raise MessageError(
                f"{self._message.__name__}: expected at most {MOST_PACKET_BYTES} bytes beside its "
                f"large arrays, got {len(payload)}"
            )
        self._count()
        self._send(payload, (message,))
        if lease is not None:
            self._pool.prepare()

    def give_back(self, message: Message | None) -> None:
        """Release the slot lent ahead that holds a message which is not sent."""
        arrays = _arrays(message)
        for lease in list(self._ahead):
            if any(lease.offset_of(array) is not None for array in arrays):
                self._ahead.remove(lease)
                self._pool.abandon(lease)

    def discard(self) -> None:
        """Release loans that were not sent, without those made ahead."""
        for lease in self._leases:
            self._pool.abandon(lease)
        self._leases.clear()

    def overrun(self) -> None:
        """Count an exposure without a free slot, and mark the edge that caused it."""
        for reader in self.readers:
            reader.account.overrun += 1
            if not reader.has_credit():
                reader.account.broken = 1

    def _counted(self) -> int:
        """Return the ordinal of the last message, of whichever instance."""
        sent = (r.account.base + r.account.sent for r in self.readers)
        return max(sent, default=first_of(self._epoch) - 1)

    def _probe_due(self) -> bool:
        """Whether it is time to probe a reader without credit."""
        if self.has_credit():
            self._no_credit_since_s = 0.0
            return False
        now_s = time.monotonic()
        probe = now_s - (self._no_credit_since_s or now_s) > PROBE_S
        if probe or not self._no_credit_since_s:
            self._no_credit_since_s = now_s
        return probe

    def _set_targets(self, receivers: list[tuple[int, int]]) -> None:
        first: list[Target] = []
        beside: list[Target] = []
        for reader, (receiver, next_receiver) in zip(self.readers, receivers, strict=True):
            first += reader.targets(receiver)
            beside += reader.targets(next_receiver)
        self._sender.set_targets(first, beside)
        self._receivers = receivers

    def _count(self) -> None:
        """Count before sending: after a kill in between, the message is lost, never sent twice."""
        self._ordinal += 1
        for reader in self.readers:
            reader.account.sent += 1

    def _send(self, payload: bytes, inline: tuple[Message, ...]) -> None:
        """Send to the readers, to taps, and complete to readers on other hosts."""
        if full := self._sender.send(payload):
            self._insist(payload, full)
        if self._taps.matching():
            self._taps.send(payload)
        if self._remote.matching():
            whole = [self._wrap(MESSAGE, None, codec.pack(message)) for message in inline]
            self._remote.send(whole[0] if whole else payload)

    def _insist(self, payload: bytes, full: list[Target]) -> None:
        """Retry for lossless readers whose socket is full of large inline messages."""
        deadline = time.monotonic() + INSIST_S
        lossless = {r.edge for r in self.readers if r.lossless}
        while (full := [t for t in full if t[0] in lossless]) and time.monotonic() < deadline:
            time.sleep(0.0005)
            full = self._sender.send(payload, full)

    def _wrap(self, kind: int, ref: SlotRef | None, body: Any, ordinal: int = -1) -> bytes:
        number = self._ordinal if ordinal < 0 else ordinal
        return Envelope.render(kind, number, self._epoch, self._fingerprint, ref, body)

    def _room_for(self, message: Message) -> Lease | None:
        """Return a slot for all large arrays: one that holds some of them, or another.

        A message is in one slot: what was lent in a second one is copied.
        """
        big = [a for a in _arrays(message) if a.nbytes > INLINE_BYTES]
        for lease in (*self._leases, *self._ahead):
            elsewhere = [a for a in big if lease.offset_of(a) is None]
            room_bytes = lease.pool.slot_bytes - lease.used_bytes
            if len(elsewhere) < len(big) and _room_bytes(elsewhere) <= room_bytes:
                return lease
        if not big:
            return None
        lease = self._pool.lease(_room_bytes(big))
        self._leases.append(lease)
        return lease

    def _claim(self, ordinal: int) -> int:
        """Return the strongest claim of all readers; taps have no account, so theirs is weakest."""
        claim = SPARE if self._taps.matching() else DONE
        for reader in self.readers:
            claim = min(claim, reader.claim(ordinal, self._ordinal))
        return claim


def _arrays(message: Message | None) -> list[NDArray[Any]]:
    """Return the arrays of a message, those in tuples and dataclasses, too."""
    found: list[NDArray[Any]] = []
    level: list[Any] = [message]
    while level:  # a hot path: no generator, no call for a field
        below: list[Any] = []
        for value in level:
            if isinstance(value, np.ndarray):
                found.append(value)
            elif isinstance(value, tuple):
                below += value
            elif hasattr(value, "__dataclass_fields__") and not isinstance(value, Header):
                below += [getattr(value, name) for name in value.__dataclass_fields__]
        level = below
    return found


def _room_bytes(arrays: Sequence[NDArray[Any]]) -> int:
    return sum(array.nbytes + ALIGN_BYTES for array in arrays)


def _place(lease: Lease | None, array: NDArray[Any]) -> bytes | int:
    """Store an array of a message, unless it is in the slot already; return offset or bytes."""
    if lease is None or array.nbytes <= INLINE_BYTES:
        return array.tobytes()
    offset = lease.offset_of(array)
    if offset is None:
        copy = lease.array(array.shape, array.dtype)
        if copy is None:
            return array.tobytes()
        copy[...] = array
        offset = lease.offset_of(copy)
    assert offset is not None
    return offset
