"""Envelopes kept for a successor, in the order in which they came.

A successor keeps them until it takes over, a predecessor until its successor has proven itself.
"""

from collections import deque

import msgspec

from pipeline.bus.envelope import HANDSHAKE, Envelope
from pipeline.bus.ledger import DROPS, EdgeAccount

MOST = 4096  # descriptors


class EdgeCut(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """Where one instance stopped reading an edge and another begins."""

    seen: int  # the last ordinal it took
    unfinished: list[int]  # of these the ones that it has not finished
    sender_epoch: int


class EnvelopeBuffer:
    """Envelopes of one edge; after the ordinal `complete_after` none is missing."""

    def __init__(self, complete_after: int | None = None) -> None:
        self.envelopes: deque[Envelope] = deque(maxlen=MOST)
        self.complete_after, self.incomplete = complete_after, False
        self._last, self._epoch = complete_after or 0, -1

    def add(self, envelope: Envelope) -> None:
        """Keep one more; before the writer's handshake there is no telling what came before it."""
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
        """Forget what is finished, up to an ordinal."""
        while self.envelopes and self.envelopes[0].ordinal <= done:
            self.envelopes.popleft()


class DropCounts:
    """What an edge's reader had dropped at some moment."""

    def __init__(self, account: EdgeAccount) -> None:
        self._drops = {reason: account.dropped(reason) for reason in DROPS}

    def refund(self, account: EdgeAccount, excess: int) -> None:
        """Take back so many of the drops that were counted since."""
        for reason, before in self._drops.items():
            back = min(max(0, excess), account.dropped(reason) - before)
            account.acknowledge(reason, -back)
            excess -= back
