"""Another agent of the same graph: whether it answers, its clock, its accounts."""

import logging
import threading
import time

from pipeline.bus.clocks import Reading
from pipeline.bus.network import Network
from pipeline.bus.session import Sender, Session
from pipeline.errors import FoveaError, MessageError
from pipeline.fleet.clock import Estimate, Offset
from pipeline.fleet.names import agent_key, host_identity
from pipeline.fleet.replication import Replication
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import decode, decode_answer, encode

PING_S = 0.2
LOST_S = 1.2  # without an answer for this long a host is lost
RECALL_S = 3.0
log = logging.getLogger(__name__)


class Peer:
    """The link of this host with one other."""

    def __init__(
        self, graph: str, own: str, replication: Replication, reading: Reading, way: Network
    ) -> None:
        """`own`: the label of this host; `reading`: of the other's clock; `way`: to its agent."""
        self.label, self._graph, self._own = replication.other, graph, own
        self.replication, self._reading = replication, reading
        self._offset = Offset()
        self._session = Session.across(way)
        self._telling: Sender = self._session.sender(self._key(f"accounts/{graph}"), urgent=True)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name=f"ping-{self.label}")
        self.answered_s = time.monotonic()
        self.lost = False
        self.losses = 0
        self.broken = ""  # why nobody looks after the link any more
        self.estimate: Estimate | None = None

    def begin(self) -> None:
        """Look after the other host from now on."""
        self.answered_s = time.monotonic()
        self._thread.start()

    def close(self) -> None:
        """Leave it alone."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._session.close()

    def tell(self, *, ready: bool, anyway: bool) -> None:
        """Send the other host what it is to know, if there is anything."""
        accounts = self.replication.tell(ready=ready, anyway=anyway)
        if accounts is not None and self._telling.matching():
            self._telling.send(encode(accounts))

    def hear(self, accounts: wire.Accounts) -> None:
        """The other host tells its accounts; while it counts as lost nobody listens."""
        if not self.lost:
            self.replication.hear(accounts)

    def recall(self) -> wire.Accounts | None:
        """What the other host knows of the edges between the two; None when it knows nothing."""
        question = encode(wire.Named(self._graph))
        data = self._session.ask(self._key("recall"), question, RECALL_S)
        try:
            return decode_answer(wire.Accounts, data, self.label) if data else None
        except FoveaError:
            return None  # it does not run there

    def _key(self, verb: str) -> str:
        return agent_key(self.label, host_identity(self._own), verb)

    def _watch(self) -> None:
        try:
            while not self._stop.wait(PING_S):
                self._ping()
                self._note_clock()
                silent_s = time.monotonic() - self.answered_s
                if self.lost != (silent_s > LOST_S):
                    self._change(silent_s)
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
        """What is known of the other clock, less sure as time goes by."""
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
