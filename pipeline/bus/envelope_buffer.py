"""A buffer of received envelopes during a handover, in the order of their arrival.

A successor buffers until it takes over, a predecessor until its successor has passed probation.
"""

from collections import deque

import msgspec

from pipeline.bus.envelope import HANDSHAKE, Envelope
from pipeline.bus.ledger import DROPS, EdgeAccount

MOST = 4096  # descriptors


class EdgeCut(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """The position on an edge at which one instance stops reading and another begins."""

    seen: int  # the last ordinal received
    unfinished: list[int]  # received ordinals that are not finished
    sender_epoch: int


class EnvelopeBuffer:
    """Envelopes of one edge, without gaps after the ordinal `complete_after`."""

    def __init__(self, complete_after: int | None = None) -> None:
        self.envelopes: deque[Envelope] = deque(maxlen=MOST)
        self.complete_after, self.incomplete = complete_after, False
        self._last, self._epoch = complete_after or 0, -1

    def add(self, envelope: Envelope) -> None:
        """Append an envelope; before the writer's handshake, earlier ones may be missing."""
        handshake = envelope.kind == HANDSHAKE
        if self.complete_after is None:
            if not handshake:
                return
            self.complete_after = envelope.ordinal
        elif not handshake and envelope.ordinal > self._last + 1 and envelope.epoch == self._epoch:
            self.incomplete = True
        self.incomplete |= len(self.envelopes) == MOST
        self._last = max(self._last, envelope.ordinal)
        self._epoch = envelope.epoch
        self.envelopes.append(envelope)

    def trim(self, done: int) -> None:
        """Discard envelopes up to an ordinal, because they are finished."""
        while self.envelopes and self.envelopes[0].ordinal <= done:
            self.envelopes.popleft()


class DropCounts:
    """A snapshot of the drop counters of an edge's reader."""

    def __init__(self, account: EdgeAccount) -> None:
        self._drops = {reason: account.dropped(reason) for reason in DROPS}

    def refund(self, account: EdgeAccount, excess: int) -> None:
        """Subtract `excess` of the drops that were counted since the snapshot."""
        for reason, before in self._drops.items():
            back = min(max(0, excess), account.dropped(reason) - before)
            account.acknowledge(reason, -back)
            excess -= back
