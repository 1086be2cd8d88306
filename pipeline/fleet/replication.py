"""Accounts of edges that cross hosts: each host keeps both halves and tells the other its own.

An account has a writing half and a reading half (`bus.ledger`). The host of the writer counts
the one, the host of the reader the other; what a host hears of the other half it puts beside its
own. So credit, slots and accounts work across hosts. A host that begins anew asks for what
it had counted before.
"""

from collections.abc import Iterable, Mapping

from pipeline.bus.ledger import DROPS, EdgeAccount, Ledger
from pipeline.graph.plan import Edge, Plan
from pipeline.protocol.fleet import Accounts

WRITTEN = ("sent", "overrun", "broken", "writer_epoch")
READ = (
    "delivered", *DROPS, "lost_in_crash", "unexpected", "attached_epoch", "reader_epoch", "seen",
)  # fmt: skip
_MOST = 1 << 63


class Replication:
    """The crossing edges of one host with one other."""

    def __init__(
        self, plan: Plan, ledger: Ledger, other: str, starts: int = 1, fingerprint: str = ""
    ) -> None:
        """`starts`: how often this host has begun; `fingerprint`: of the graph on all hosts."""
        self._ledger, self.other, self._fingerprint = ledger, other, fingerprint
        self.out = [e for e in plan.edges if _between(plan, e) == (plan.here, other)]
        self.into = [e for e in plan.edges if _between(plan, e) == (other, plan.here)]
        self._number = starts << 32  # what is told after a new start counts as newer
        self._heard = 0
        self.other_ready = False
        self._said: tuple[object, ...] = ()

    def tell(self, *, ready: bool, anyway: bool) -> Accounts | None:
        """What the other host is to know; None while nothing has changed."""
        edges = self._ledger.edges
        written = {e.index: _values(edges[e.index], WRITTEN) for e in self.out}
        read = {e.index: _values(edges[e.index], READ) for e in self.into}
        said = (ready, written, read)
        if said == self._said and not anyway:
            return None
        self._said = said
        self._number += 1
        return Accounts(self._number, self._fingerprint, ready, written, read)

    def hear(self, heard: Accounts) -> None:
        """Put the other's halves beside ours; what is not the other's to tell is left out."""
        if heard.number <= self._heard or heard.fingerprint != self._fingerprint:
            return
        self._heard = heard.number
        self._put(heard.written, self.into, WRITTEN)
        self._put(heard.read, self.out, READ)
        self.other_ready = heard.ready

    def lost(self) -> None:
        """The other host is gone: nobody waits for its readers, and it may begin to count anew."""
        self.other_ready, self._heard = False, 0
        for edge in self.out:
            self._ledger.edges[edge.index].reader_epoch = 0

    def whole(self) -> Accounts:
        """Both halves of everything shared, for a host that lost its own."""
        edges = self._ledger.edges
        shared = [*self.out, *self.into]
        return Accounts(
            0, self._fingerprint, True,
            {e.index: _values(edges[e.index], WRITTEN) for e in shared},
            {e.index: _values(edges[e.index], READ) for e in shared},
        )  # fmt: skip

    def _put(
        self, values: Mapping[int, tuple[int, ...]], allowed: Iterable[Edge], names: tuple[str, ...]
    ) -> None:
        for edge in allowed:
            got = values.get(edge.index, ())
            if len(got) == len(names) and all(0 <= value < _MOST for value in got):
                account = self._ledger.edges[edge.index]
                for name, value in zip(names, got, strict=True):
                    setattr(account, name, value)


def adopt(plan: Plan, ledger: Ledger, told: Iterable[Accounts]) -> None:
    """Before anything starts: go on from what the other hosts know of this one's accounts.

    What was on its way inside this host was lost with it.
    """
    for accounts in told:
        for edge in plan.edges:
            written = accounts.written.get(edge.index, ())
            read = accounts.read.get(edge.index, ())
            if not plan.crosses(edge) or len(written) != len(WRITTEN) or len(read) != len(READ):
                continue
            account = ledger.edges[edge.index]
            for name, value in (*zip(WRITTEN, written, strict=True), *zip(READ, read, strict=True)):
                if not name.endswith("_epoch") and 0 <= value < _MOST:
                    setattr(account, name, value)
            account.sent = max(account.sent, account.seen)
    for edge in plan.edges:
        account = ledger.edges[edge.index]
        readers = plan.readers(edge.source, edge.output)
        newest = max(ledger.edges[e.index].sent for e in readers)
        if plan.node(edge.source).host != plan.here or account.sent == newest:
            continue
        if plan.crosses(edge):
            account.sent = newest  # the reader there will find that some are missing
        else:
            account.base = newest  # it begins now; its numbers go on


def _between(plan: Plan, edge: Edge) -> tuple[str, str]:
    return plan.node(edge.source).host, plan.node(edge.target).host


def _values(account: EdgeAccount, names: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(int(getattr(account, name)) for name in names)
