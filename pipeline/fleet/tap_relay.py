"""Taps on outputs of this host for those who may deploy: messages kept until they are fetched.

Who listens asks again and again; what came since is the answer. A tap keeps so many messages and
bytes and no more, and is closed when nobody has asked for it for a while.
"""

import secrets
import threading
import time
from collections import deque
from contextlib import ExitStack
from dataclasses import dataclass, field

from pipeline.errors import RunError
from pipeline.fleet.hosted_graph import HostedGraph
from pipeline.naming import check_name
from pipeline.node.wiring import key_of
from pipeline.protocol import fleet as wire
from pipeline.run.bus_client import client_session
from pipeline.run.supervisor import Supervisor
from pipeline.settings import suggest

MOST_TAPS = 8  # on one host
MOST_KEPT = 512  # messages of one tap
MOST_KEPT_BYTES = 256 << 10
IDLE_S = 5.0  # a tap that nobody asks for any longer is closed
Key = tuple[str, str]  # who listens, and the name of the tap


@dataclass
class _Tap:
    """One tap; `hear` is called by the transport's thread."""

    place: str
    asked_s: float
    supervisor: Supervisor | None = None  # of the run that it listens to
    open: ExitStack = field(default_factory=ExitStack)
    kept: deque[tuple[int, bytes]] = field(default_factory=deque)
    kept_bytes: int = 0
    skipped: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def hear(self, payload: bytes) -> None:
        """Keep one message, or count that there was no room."""
        with self.lock:
            size = self.kept_bytes + len(payload)
            if len(self.kept) >= MOST_KEPT or size > MOST_KEPT_BYTES:
                self.skipped += 1
                return
            self.kept.append((time.monotonic_ns(), payload))
            self.kept_bytes = size

    def fetch(self) -> tuple[tuple[tuple[int, bytes], ...], int]:
        """What was kept, and how many were not, in all."""
        with self.lock:
            kept, self.kept_bytes = tuple(self.kept), 0
            self.kept.clear()
            return kept, self.skipped


class TapRelay:
    """The taps of one agent. Any of its threads may call."""

    def __init__(self) -> None:
        self._taps: dict[Key, _Tap] = {}
        self._lock = threading.Lock()

    def close(self) -> None:
        """Close all of them."""
        with self._lock:
            for tap in self._taps.values():
                tap.open.close()
            self._taps.clear()

    def tidy(self) -> None:
        """Close those that nobody asks for any longer."""
        late_s = time.monotonic() - IDLE_S
        with self._lock:
            for key in [key for key, tap in self._taps.items() if tap.asked_s < late_s]:
                self._taps.pop(key).open.close()

    def fetch(self, hosted: HostedGraph, asked: wire.TapQuestion, asker: str) -> wire.TapMessages:
        """What an output sent since the last time; raises `RunError`."""
        supervisor = hosted.supervisor
        nodes = [n.name for n in hosted.plan.nodes if hosted.plan.is_here(n)]
        if asked.node not in nodes:
            raise RunError(f"{hosted.plan.name}: no node {asked.node} here"
                           f"{suggest(asked.node, nodes)}")  # fmt: skip
        if supervisor is None:
            raise RunError(f"{hosted.plan.name}: does not run just now, try again")
        output = check_name(asked.output, "output")
        key = key_of(hosted.plan.name, asked.node, output)
        with self._lock:
            tap = self._tap((asker, asked.tap), key)
            if tap.supervisor is not supervisor:
                self._listen(tap, hosted.folder, supervisor)
            tap.asked_s = time.monotonic()
        kept, skipped = tap.fetch()
        clocks = hosted.clocks
        ahead = {label: clocks.ahead_ns(label) for label in hosted.plan.hosts}
        known = {label: ns for label, ns in ahead.items() if ns is not None}
        return wire.TapMessages(kept, skipped, time.monotonic_ns(), known)

    def _tap(self, key: Key, place: str) -> _Tap:
        tap = self._taps.get(key)
        if tap is not None and tap.place == place:
            return tap
        if tap is not None:
            raise RunError(f"{key[1]}: listens to another output already")
        if len(self._taps) >= MOST_TAPS:
            raise RunError(f"busy: expected up to {MOST_TAPS} taps on a host, got more")
        tap = self._taps[key] = _Tap(place, time.monotonic())
        return tap

    def _listen(self, tap: _Tap, folder: str, supervisor: Supervisor) -> None:
        tap.open.close()
        session = tap.open.enter_context(client_session(folder, "relay"))
        tap.open.callback(session.listen(tap.place, tap.hear))
        tap.supervisor = supervisor


def new_name() -> str:
    """A name for a tap, which no other has."""
    return secrets.token_hex(8)
