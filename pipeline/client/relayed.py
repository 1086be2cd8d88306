"""A tap on an output on another host, polled through the agent of that host."""

import threading
import time
from contextlib import ExitStack

from pipeline.bus.tap import Heard, Tap
from pipeline.client.described import Description
from pipeline.client.graph_client import GraphClient, Listener, output_of
from pipeline.errors import FoveaError
from pipeline.fleet.deploy import Fleet
from pipeline.fleet.hosts import Hosts
from pipeline.fleet.relay import new_name
from pipeline.protocol import fleet as wire

POLL_S = 0.1


class RelayedTap(Listener):
    """A tap whose messages are fetched from an agent ten times a second."""

    def __init__(self, client: GraphClient, hosts: Hosts, output: str) -> None:
        """Raises `FoveaError` for an unknown output."""
        self.graph, self.output, self._client, self._hosts = client.name, output, client, hosts
        self._node, self._port, schema = output_of(client, output)
        self.tap = Tap(Description(schema))
        self._open, self._stop = ExitStack(), threading.Event()
        self._over = ""
        self._behind_ns: int | None = None  # offset to add to the host's time to get this host's
        self._ahead_ns: dict[str, int] = {}

    def __enter__(self) -> "Listener":
        fleet = self._open.enter_context(Fleet(self._hosts))
        thread = threading.Thread(target=self._listen, args=(fleet,), name=f"tap-{self.output}")
        self._open.callback(thread.join)
        self._open.callback(self._stop.set)
        thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def over(self) -> str:
        """Return why no more messages will come, as a sentence; empty while they may."""
        if self._over:
            return self._over
        return "" if self._client.runs() else f"{self.graph}: the graph has ended"

    def age_ns(self, heard: Heard) -> int | None:
        """Return the exposure's age when its message arrived; None if its clock is not known."""
        ahead = self._ahead_ns.get(heard.header.clock)
        if ahead is None or self._behind_ns is None:
            return None
        return heard.at_ns - self._behind_ns + ahead - heard.header.stamp_ns

    def _listen(self, fleet: Fleet) -> None:
        asked = wire.TapQuestion(self.graph, self._node, self._port, new_name())
        label = self._hosts.nodes[self._node]
        try:
            while not self._stop.is_set():
                before_ns = time.monotonic_ns()
                found = fleet.ask(label, "tap", asked, wire.TapMessages)
                if self._behind_ns is None:  # measured once, so that gaps are as on that host
                    self._behind_ns = (before_ns + time.monotonic_ns()) // 2 - found.now_ns
                self._ahead_ns = found.ahead_ns
                for at_ns, payload in found.heard:
                    self.tap.receive(payload, at_ns + self._behind_ns)
                self.tap.skipped = found.skipped
                self._stop.wait(POLL_S)
        except FoveaError as error:
            self._over = f"{self.graph}: {error}"
