"""Another box of the same graph: is it there, what does its clock show, what has it counted."""

import logging
import threading
import time
from dataclasses import replace

from pipeline.bus.clocks import Clocks
from pipeline.bus.ledger import Ledger
from pipeline.bus.network import Network
from pipeline.bus.session import Sender, Session
from pipeline.errors import FoveaError, MessageError
from pipeline.fleet import wire
from pipeline.fleet.clock import Estimate, Offset
from pipeline.fleet.mirror import Mirror
from pipeline.fleet.names import agent_key, box
from pipeline.graph.plan import Plan

PING_S = 0.2
LOST_S = 1.2  # without an answer for this long a box is lost
RECALL_S = 3.0
log = logging.getLogger(__name__)


class Neighbour:
    """The link of this box with one other."""

    def __init__(
        self, graph: str, plan: Plan, ledger: Ledger, clocks: Clocks, label: str, point: str,
        way: Network, starts: int,
    ) -> None:  # fmt: skip
        self.label, self._graph, self._own = label, graph, plan.here
        self.mirror = Mirror(plan, ledger, label, starts)
        self._reading = clocks.readings[label]
        self._offset = Offset()
        self._session = Session.across(replace(way, connect=(point,)))
        self._telling: Sender = self._session.sender(self._key(f"accounts/{graph}"), urgent=True)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name=f"ping-{label}")
        self.answered_s = time.monotonic()
        self.lost = False
        self.losses = 0
        self.estimate: Estimate | None = None

    def begin(self) -> None:
        """Look after the other box from now on."""
        self.answered_s = time.monotonic()
        self._thread.start()

    def close(self) -> None:
        """Leave it alone."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        self._session.close()

    def tell(self, *, ready: bool, anyway: bool) -> None:
        """Send the other box what it is to know, if there is anything."""
        accounts = self.mirror.tell(ready=ready, anyway=anyway)
        if accounts is not None and self._telling.matching():
            self._telling.send(wire.encode(accounts))

    def recall(self) -> wire.Accounts | None:
        """What the other box knows of the edges between the two; None when it knows nothing."""
        question = wire.encode(wire.Named(self._graph))
        data = self._session.ask(self._key("recall"), question, RECALL_S)
        try:
            return wire.read_reply(wire.Accounts, self.label, data) if data else None
        except FoveaError:
            return None  # it does not run there

    def _key(self, verb: str) -> str:
        return agent_key(self.label, box(self._own), verb)

    def _watch(self) -> None:
        while not self._stop.wait(PING_S):
            self._ping()
            silent_s = time.monotonic() - self.answered_s
            if self.lost != (silent_s > LOST_S):
                self._change(silent_s)

    def _change(self, silent_s: float) -> None:
        self.lost = not self.lost
        if self.lost:
            self.losses += 1
            self.mirror.lost()
            log.error("%s: box %s is lost: silent for %.1f s", self._graph, self.label, silent_s)
        else:
            log.warning("%s: box %s is back", self._graph, self.label)

    def _ping(self) -> None:
        ping = wire.encode(wire.Ping(time.monotonic_ns()))
        data = self._session.ask(self._key("ping"), ping, LOST_S / 3)
        back_ns = time.monotonic_ns()
        if data is None:
            return
        try:
            pong = wire.decode(wire.Pong, data)
        except MessageError:
            return
        self.answered_s = time.monotonic()
        self._offset.add(pong.sent_ns, pong.came_ns, pong.left_ns, back_ns)
        self.estimate = self._offset.estimate(back_ns)
        if self.estimate is not None:
            self._reading.offset_ns = self.estimate.offset_ns
            self._reading.error_ns = self.estimate.error_ns
