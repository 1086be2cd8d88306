"""Other agents of the same graph: liveness, clock offsets and replicated accounts.

Clock offset: a ping leaves at t1 by our clock, arrives at t2 and its reply leaves at t3 by theirs,
and arrives at t4 by ours. Whatever the delay of either direction, the offset is wrong by at most
half of the round trip, so the fastest exchanges are the most accurate (RFC 5905, section 8). Two
crystals drift apart by up to `DRIFT`, which increases the error of older exchanges.

An account has a writing half and a reading half (`bus.ledger`). The writer's host counts the one,
the reader's host the other, and each host stores the half that it receives beside its own. Credit,
slots and accounts thus work across hosts. A restarted host asks for its former counts.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from pipeline.bus.clocks import Reading
from pipeline.bus.ledger import DROPS, EdgeAccount, Ledger
from pipeline.bus.session import Sender, Session
from pipeline.errors import FoveaError, MessageError
from pipeline.fleet.names import agent_key, host_identity
from pipeline.graph.plan import Edge, Plan
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import decode, decode_answer, encode
from pipeline.protocol.fleet import Accounts

DRIFT = 100e-6  # two crystals of 50 ppm
KEPT = 64
WRITTEN = ("sent", "overrun", "broken", "writer_epoch")
READ = (
    "delivered", *DROPS, "lost_in_crash", "unexpected", "attached_epoch", "reader_epoch", "seen",
)  # fmt: skip
_MOST = 1 << 63
PING_S = 0.2
LOST_S = 1.2  # a host without a reply for this long is lost
RECALL_S = 3.0
REOPEN_S = (5.0, 60.0)  # first and longest silence after which a new link is tried
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Estimate:
    """Their clock minus ours; the true offset is within the error."""

    offset_ns: int
    error_ns: int
    round_trip_ns: int


class Offset:
    """The best estimate from the last exchanges with one host."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, int, int]] = deque(maxlen=KEPT)  # time, offset, round trip

    def add(self, sent_ns: int, came_ns: int, left_ns: int, back_ns: int) -> None:
        """Add an exchange; ignore an impossible one (a reply before its ping)."""
        way = (back_ns - sent_ns) - (left_ns - came_ns)
        if left_ns < came_ns or way < 0:
            return
        offset = ((came_ns - sent_ns) + (left_ns - back_ns)) // 2
        known = self.estimate(back_ns)
        if known and abs(offset - known.offset_ns) > known.error_ns + way // 2 + 1:
            self._seen.clear()  # the other clock was reset: earlier exchanges are invalid
        self._seen.append((back_ns, offset, way))

    def estimate(self, now_ns: int) -> Estimate | None:
        """Return the best estimate now; None without an exchange.

        >>> clock = Offset()
        >>> clock.add(0, 1_000_100, 1_000_200, 300)
        >>> clock.add(1000, 1_001_900, 1_002_000, 5000)
        >>> clock.estimate(5000)
        Estimate(offset_ns=1000000, error_ns=101, round_trip_ns=200)
        """
        best = min(
            ((way / 2 + DRIFT * (now_ns - at), offset, way) for at, offset, way in self._seen),
            default=None,
        )
        if best is None:
            return None
        error, offset, way = best
        return Estimate(offset, max(1, int(error) + 1), way)


class Replication:
    """The accounts of the edges between this host and another."""

    def __init__(
        self, plan: Plan, ledger: Ledger, other: str, starts: int = 1, fingerprint: str = ""
    ) -> None:
        """`starts`: number of starts of this host; `fingerprint`: of the graph on all hosts."""
        self._ledger, self.other, self._fingerprint = ledger, other, fingerprint
        self.out = [e for e in plan.edges if _between(plan, e) == (plan.here, other)]
        self.into = [e for e in plan.edges if _between(plan, e) == (other, plan.here)]
        self._number = starts << 32  # numbers after a restart are higher
        self._heard = 0
        self.other_ready = False
        self._said: tuple[object, ...] = ()

    def tell(self, *, ready: bool, anyway: bool) -> Accounts | None:
        """Return this host's half of the accounts; None while nothing has changed."""
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
        """Store the other host's halves; ignore counters that it does not own."""
        if heard.number <= self._heard or heard.fingerprint != self._fingerprint:
            return
        self._heard = heard.number
        self._put(heard.written, self.into, WRITTEN)
        self._put(heard.read, self.out, READ)
        self.other_ready = heard.ready

    def lost(self) -> None:
        """Handle a lost host: nothing waits for its readers, and its numbers may restart."""
        self.other_ready, self._heard = False, 0
        for edge in self.out:
            self._ledger.edges[edge.index].reader_epoch = 0

    def whole(self) -> Accounts:
        """Return both halves of all shared accounts, for a host that lost its own."""
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
    """Restore this host's accounts from the other hosts' copies, before anything starts.

    Messages that were in flight inside this host are lost.
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
            account.sent = newest  # the reader there will detect the missing ones
        else:
            account.base = newest  # the edge begins now, its ordinals continue


def _between(plan: Plan, edge: Edge) -> tuple[str, str]:
    return plan.node(edge.source).host, plan.node(edge.target).host


def _values(account: EdgeAccount, names: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(int(getattr(account, name)) for name in names)


class Sessions:
    """The sessions over which other hosts are reached; each is closed once no host needs it."""

    def __init__(self, opened: Callable[[tuple[str, ...]], Session], points: Iterable[str]) -> None:
        """`opened`: opens a session to end points. The first one is for all of `points`, since
        opening one takes a second while others do not answer.
        """
        self._opened = opened
        everywhere = tuple(sorted(set(points)))
        self._newest = dict.fromkeys(everywhere, opened(everywhere)) if everywhere else {}
        self._users = dict.fromkeys(self._newest.values(), 0)  # of each open session
        self._lock = threading.Lock()

    def join(self, point: str) -> Session:
        """Return the newest session to an end point, for one host behind it."""
        with self._lock:
            self._users[self._newest[point]] += 1
            return self._newest[point]

    def renew(self, point: str, before: Session) -> Session:
        """Return a newer session than the one before, which is still to be left.

        Hosts behind one router share it.
        """
        with self._lock:
            newest = self._newest[point]
            if newest is before or newest not in self._users:
                newest = self._newest[point] = self._opened((point,))
                self._users[newest] = 0
            self._users[newest] += 1
            return newest

    def leave(self, session: Session) -> None:
        """Reach a host over this session no longer."""
        with self._lock:
            self._users[session] -= 1
            unused = not self._users[session]
            if unused:
                del self._users[session]
        if unused:
            session.close()

    def close(self) -> None:
        """Close what is still open."""
        with self._lock:
            for session in self._users:
                session.close()
            self._users.clear()


class Peer:
    """The link of this host to another."""

    def __init__(
        self, graph: str, own: str, replication: Replication, reading: Reading,
        sessions: Sessions, point: str,
    ) -> None:  # fmt: skip
        """`own`: this host's label; `reading`: of the other's clock; `point`: where it is."""
        self.label, self._graph, self._own = replication.other, graph, own
        self.replication, self._reading = replication, reading
        self._offset = Offset()
        self._sessions, self._point = sessions, point
        self._session = sessions.join(point)
        self._sending = threading.Lock()
        self._telling = self._sender()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name=f"ping-{self.label}")
        self.answered_s = time.monotonic()
        self.lost = False
        self.losses = 0
        self.broken = ""  # why the link is no longer monitored
        self.estimate: Estimate | None = None

    def begin(self) -> None:
        """Start monitoring the other host."""
        self.answered_s = time.monotonic()
        self._thread.start()

    def close(self) -> None:
        """Stop monitoring the other host."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._sessions.leave(self._session)

    def tell(self, *, ready: bool, anyway: bool) -> bool:
        """Send the other host this host's half of the accounts; return False if it is unchanged."""
        accounts = self.replication.tell(ready=ready, anyway=anyway)
        if accounts is not None:
            with self._sending:
                if self._telling.matching():
                    self._telling.send(encode(accounts))
        return accounts is not None

    def hear(self, accounts: wire.Accounts) -> None:
        """Receive the other host's accounts; ignore them while it counts as lost."""
        if not self.lost:
            self.replication.hear(accounts)

    def recall(self) -> wire.Accounts | None:
        """Ask the other host for the accounts of the shared edges; None when it has none."""
        question = encode(wire.Named(self._graph))
        data = self._session.ask(self._key("recall"), question, RECALL_S)
        try:
            return decode_answer(wire.Accounts, data, self.label) if data else None
        except FoveaError:
            return None  # the graph does not run there

    def _sender(self) -> Sender:
        return self._session.sender(self._key(f"accounts/{self._graph}"), urgent=True)

    def _reopen(self) -> None:
        """Reach the other host over a new session.

        A link that broke while its processors were busy with other things may stay away for ever:
        one side takes it for its predecessor, closes it, and the other does not hear of that.
        """
        after = self._sessions.renew(self._point, self._session)
        with self._sending:
            before, self._session = self._session, after
            self._telling = self._sender()
        self._sessions.leave(before)

    def _key(self, verb: str) -> str:
        return agent_key(self.label, host_identity(self._own), verb)

    def _watch(self) -> None:
        opened_s, patience_s = time.monotonic(), REOPEN_S[0]
        try:
            while not self._stop.wait(PING_S):
                self._ping()
                self._note_clock()
                now_s = time.monotonic()
                silent_s = now_s - self.answered_s
                if self.lost != (silent_s > LOST_S):
                    self._change(silent_s)
                if not self.lost:
                    patience_s = REOPEN_S[0]
                elif min(silent_s, now_s - opened_s) > patience_s:
                    self._reopen()
                    opened_s, patience_s = time.monotonic(), min(2 * patience_s, REOPEN_S[1])
        except Exception as error:
            log.exception("%s: the link with host %s broke", self._graph, self.label)
            self.broken = f"the link with host {self.label} broke: {type(error).__name__}: {error}"

    def _change(self, silent_s: float) -> None:
        self.lost = not self.lost
        if self.lost:
            self.losses += 1
            self.replication.lost()
            log.error("%s: host %s is lost: silent for %.1f s", self._graph, self.label, silent_s)
        else:
            log.warning("%s: host %s is back", self._graph, self.label)

    def _note_clock(self) -> None:
        """Publish the estimate of the other clock, whose error grows with its age."""
        self.estimate = self._offset.estimate(time.monotonic_ns())
        if self.estimate is not None:
            self._reading.offset_ns = self.estimate.offset_ns
            self._reading.error_ns = self.estimate.error_ns

    def _ping(self) -> None:
        ping = encode(wire.Ping(time.monotonic_ns()))
        data = self._session.ask(self._key("ping"), ping, LOST_S / 3)
        back_ns = time.monotonic_ns()
        if data is None:
            return
        try:
            pong = decode(wire.Pong, data)
        except MessageError:
            return
        self.answered_s = time.monotonic()
        self._offset.add(pong.sent_ns, pong.came_ns, pong.left_ns, back_ns)
