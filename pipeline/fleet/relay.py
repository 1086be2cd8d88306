"""Relay requests of other hosts to this host's nodes, and their outputs to remote taps.

The rules for deployed graphs apply: code by allow list, files by checksum. A remote listener polls
a tap for new messages. A tap is bounded in messages and bytes, and closed when it is not polled for
a while.
"""

import logging
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from threading import BoundedSemaphore
from typing import Any

import msgspec

from pipeline.errors import FoveaError, RunError
from pipeline.fleet.agent_file import GraphStore
from pipeline.fleet.hosted_graph import HostedGraph, carry_out, keep_swap
from pipeline.fleet.placement import Allowed
from pipeline.naming import check_name
from pipeline.node.wiring import key_of
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import ControlMessage, encode, failed, refused
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.questions import Command, ConfigQuestion, NodeQuestion
from pipeline.run.bus_client import ask_local, client_session
from pipeline.run.supervisor import Supervisor
from pipeline.settings import suggest

AT_ONCE = 4  # a node answers between two frames; one that hangs must not delay the others
WAITING = 16
Reply = Callable[[bytes], None]
MOST_TAPS = 8  # per client and host
MOST_KEPT = 512  # messages kept per tap
MOST_KEPT_BYTES = 256 << 10
IDLE_S = 5.0  # a tap without a poll for this long is closed
Key = tuple[str, str]  # client, name of the tap
log = logging.getLogger(__name__)


class NodeGateway:
    """Forwards requests to the nodes of a host."""

    def __init__(
        self, allowed: Allowed, over: Mapping[str, Mapping[str, Any]], store: GraphStore
    ) -> None:
        """`over`: settings that this host fixes, by node; nobody else may change them."""
        self._allowed, self._over, self._store = allowed, over, store
        self._pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="gateway")
        self._room = BoundedSemaphore(AT_ONCE + WAITING)

    def close(self) -> None:
        """Stop answering."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def ask(self, hosted: HostedGraph, asked: wire.ToNode, reply: Reply) -> None:
        """Ask a node and reply when it answers; raises `FoveaError`."""
        check_here(hosted, asked.node)
        question = self._cleared(asked)

        def answer() -> ControlMessage:
            said = ask_local(hosted.folder, hosted.plan.name, asked.node, question)
            return wire.Relayed(said)

        self.submit(answer, reply)

    def submit(self, answer: Callable[[], ControlMessage], reply: Reply) -> None:
        """Reply with the result of `answer` from another thread; raises `RunError` if busy."""
        if not self._room.acquire(blocking=False):
            raise RunError("busy: too many questions to nodes are pending")
        self._pool.submit(self._answer, answer, reply)

    def swap(self, hosted: HostedGraph, order: SwapOrder, reply: Reply) -> None:
        """Swap a node and reply when that is done; raises `FoveaError`."""
        check_here(hosted, order.node)
        supervisor = hosted.supervisor
        if supervisor is None:
            raise RunError(f"{hosted.plan.name}: is not running now, try again")
        if order.operator:
            self._allowed.check_code(order.operator, f"{order.node}.operator")
        changes = {**self._cleared_values(order.node, order.changes), **self._own(order.node)}
        local = msgspec.structs.replace(order, changes=changes)

        keep = partial(keep_swap, hosted, supervisor, order, local, self._store)
        carry_out(hosted, supervisor, local, keep, reply)

    def _answer(self, answer: Callable[[], ControlMessage], reply: Reply) -> None:
        try:
            reply(encode(answer()))
        except FoveaError as error:
            reply(encode(refused(str(error))))
        except Exception as error:
            log.exception("answering a question failed")
            reply(encode(failed(error)))
        finally:
            self._room.release()

    def _cleared(self, asked: wire.ToNode) -> NodeQuestion:
        """Return the question with checked, localised values; raises `FoveaError`."""
        question = asked.question
        if isinstance(question, ConfigQuestion):
            return ConfigQuestion(self._cleared_values(asked.node, question.changes))
        if isinstance(question, Command):
            where = f"{asked.node} {question.command}"
            return Command(question.command, self._allowed.localise(question.arguments, where))
        return question

    def _cleared_values(self, node: str, changes: Mapping[str, Any]) -> dict[str, Any]:
        for name in changes:
            if name.partition(".")[0] in self._own(node):  # a swap may name a part of a setting
                raise RunError(f"{node}.{name}: this host sets it itself")
        return {k: self._allowed.localise(v, f"{node}.{k}") for k, v in changes.items()}

    def _own(self, node: str) -> Mapping[str, Any]:
        return self._over.get(node, {})


def check_here(hosted: HostedGraph, node: str) -> None:
    """Raise `RunError` for a node that this host does not run."""
    names = [n.name for n in hosted.plan.nodes if hosted.plan.is_here(n)]
    if node not in names:
        raise RunError(f"{hosted.plan.name}: no node {node} here{suggest(node, names)}")


@dataclass
class _Tap:
    """A tap; the transport's thread calls `hear`."""

    place: str
    asked_s: float
    asking: int = 0  # polls in progress, which keep it open
    supervisor: Supervisor | None = None  # of the tapped run
    open: ExitStack = field(default_factory=ExitStack)
    opening: threading.Lock = field(default_factory=threading.Lock)
    kept: deque[tuple[int, bytes]] = field(default_factory=deque)
    kept_bytes: int = 0
    skipped: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def hear(self, payload: bytes) -> None:
        """Store a message, or count it as skipped for lack of room."""
        with self.lock:
            size = self.kept_bytes + len(payload)
            if len(self.kept) >= MOST_KEPT or size > MOST_KEPT_BYTES:
                self.skipped += 1
                return
            self.kept.append((time.monotonic_ns(), payload))
            self.kept_bytes = size

    def fetch(self) -> tuple[tuple[tuple[int, bytes], ...], int]:
        """Return the stored messages and the total number of skipped ones."""
        with self.lock:
            kept, self.kept_bytes = tuple(self.kept), 0
            self.kept.clear()
            return kept, self.skipped


class TapRelay:
    """The taps of one agent; thread-safe.

    The lock protects only the table: sessions are opened and closed outside of it.
    """

    def __init__(self) -> None:
        self._taps: dict[Key, _Tap] = {}
        self._lock = threading.Lock()

    def close(self) -> None:
        """Close all taps."""
        with self._lock:
            taps = list(self._taps.values())
            self._taps.clear()
        for tap in taps:
            tap.open.close()

    def tidy(self) -> None:
        """Close taps that are no longer polled."""
        late_s = time.monotonic() - IDLE_S
        with self._lock:
            idle = [k for k, t in self._taps.items() if not t.asking and t.asked_s < late_s]
            taps = [self._taps.pop(key) for key in idle]
        for tap in taps:
            tap.open.close()

    def fetch(self, hosted: HostedGraph, asked: wire.TapQuestion, asker: str) -> wire.TapMessages:
        """Return what an output sent since the last poll; raises `RunError`."""
        supervisor = hosted.supervisor
        check_here(hosted, asked.node)
        if supervisor is None:
            raise RunError(f"{hosted.plan.name}: is not running now, try again")
        name, output = check_name(asked.tap, "tap"), check_name(asked.output, "output")
        place = key_of(hosted.plan.name, asked.node, output)
        with self._asked((asker, name), place) as tap:
            with tap.opening:
                if tap.supervisor is not supervisor:
                    self._listen(tap, hosted.folder, supervisor)
            kept, skipped = tap.fetch()
        clocks = hosted.clocks
        ahead = {label: clocks.ahead_ns(label) for label in hosted.plan.hosts}
        known = {label: ns for label, ns in ahead.items() if ns is not None}
        return wire.TapMessages(kept, skipped, time.monotonic_ns(), known)

    @contextmanager
    def _asked(self, key: Key, place: str) -> Iterator[_Tap]:
        """Yield a tap that stays open during the block."""
        with self._lock:
            tap = self._tap(key, place)
            tap.asking += 1
        try:
            yield tap
        finally:
            with self._lock:
                tap.asking -= 1
                tap.asked_s = time.monotonic()

    def _tap(self, key: Key, place: str) -> _Tap:
        tap = self._taps.get(key)
        if tap is not None and tap.place == place:
            return tap
        if tap is not None:
            raise RunError(f"{key[1]}: listens to another output already")
        if sum(asker == key[0] for asker, _ in self._taps) >= MOST_TAPS:
            raise RunError(f"busy: expected up to {MOST_TAPS} taps of one asker, got more")
        tap = self._taps[key] = _Tap(place, time.monotonic())
        return tap

    def _listen(self, tap: _Tap, folder: str, supervisor: Supervisor) -> None:
        tap.open.close()
        session = tap.open.enter_context(client_session(folder, "relay"))
        tap.open.callback(session.listen(tap.place, tap.hear))
        tap.supervisor = supervisor


def new_name() -> str:
    """Return a unique name for a tap."""
    return secrets.token_hex(8)
