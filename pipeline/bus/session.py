"""Zenoh sessions; the only module that imports Zenoh.

Every node listens on its own unix socket in a private directory and connects to the hub (the
supervisor's session); gossip then establishes direct links between peers. Only a session `across`
hosts listens on a network, no multicast is sent, and Zenoh's own shared memory is off, because
frames go through `pipeline.bus.pool`.
"""

import json
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import zenoh

from pipeline.bus.network import Network
from pipeline.bus.sockets import hasten
from pipeline.errors import RunError

OnBytes = Callable[[bytes], None]
OnQuestion = Callable[[bytes, OnBytes], None]  # the question, and how to reply
LOGGED = "error,zenoh::net::protocol::gossip=off"  # gossip logs a leaving peer as an error
PANIC = "PanicException"  # raised by Rust without descriptors or threads; not importable
_SOURCE_LINE = re.compile(r" at /\S+\.rs:\d+\.?")  # a source line of Zenoh
_TAKEN = re.compile("acquire lock|in use", re.IGNORECASE)
AGAIN_S = 0.05  # a new session takes time to discover who answers


class Sender(Protocol):
    """The publisher of one key."""

    def send(self, payload: bytes) -> None:
        """Pass a payload to the transport; wait for a reader only if the session has a timeout."""
        ...

    def matching(self) -> bool:
        """Whether there is a subscriber."""
        ...


class Session:
    """A peer on the graph's bus. Close it, or Zenoh keeps the process alive at its end."""

    def __init__(
        self, folder: Path, name: str, *, hub: str = "hub", timeout_s: float = 10.0,
        guest: bool = False,
    ) -> None:  # fmt: skip
        """`timeout_s`: how long a frozen peer may delay opening or closing a link.

        A `guest` does not listen: it leaves no socket behind, however it ends, and no other process
        ever waits for it to open a link.
        """
        self._files: tuple[Path, ...] = ()
        if name != hub and not guest:  # the hub's socket is removed with the run's folder
            self._files = (folder / f"{name}.sock", folder / f"{name}.sock.lock")
        own = f"unixsock-stream/{folder / name}.sock"
        links = {"listen": {"endpoints": [] if guest else [own]}}
        if name != hub:
            links["connect"] = {"endpoints": [f"unixsock-stream/{folder / hub}.sock"]}
        unicast = {"open_timeout": int(timeout_s * 1000)}
        transport = {"transport": {**_TRANSPORT, "unicast": unicast}}
        self._session = _open({**links, **_COMMON, **transport}, f"{folder}: no bus there")

    @classmethod
    def across(cls, network: Network) -> "Session":
        """Open a session with other hosts, without waiting for them."""
        session = cls.__new__(cls)
        session._files = ()
        session._session = _open(network.config(), ", ".join(network.listen) or "network")
        session._session.info.declare_link_events_listener(
            zenoh.handlers.Callback(_hasten, indirect=False), history=True
        )
        return session

    def sender(self, key: str, *, urgent: bool = False, patient: bool = False) -> Sender:
        """Return a publisher; an `urgent` one (sensor commands) overtakes everything else.

        Descriptors are small, and the runtime's credit limits their number: a queue can only fill
        up behind a stopped reader, and waiting for it would block the others. Complete pictures
        need a `patient` sender, which waits for the link.
        """
        control = zenoh.CongestionControl
        publisher = self._session.declare_publisher(
            key,
            congestion_control=control.BLOCK if patient else control.DROP,
            priority=zenoh.Priority.REAL_TIME if urgent else zenoh.Priority.DATA,
            express=True,
        )
        return _Sender(publisher)

    def listen(self, key: str, on_bytes: OnBytes) -> Callable[[], None]:
        """Call `on_bytes` on the transport's thread for every payload; return a function to stop.

        The callback must be fast and must not call the bus.
        """

        def receive(sample: zenoh.Sample) -> None:
            on_bytes(sample.payload.to_bytes())

        subscriber = self._session.declare_subscriber(
            key, zenoh.handlers.Callback(receive, indirect=False)
        )
        return subscriber.undeclare

    def answer(self, key: str, on_question: OnQuestion) -> Callable[[], None]:
        """Call `on_question` on the transport's thread for every query; return a function to stop.

        It must be fast; it may reply later, from any thread, at most once.
        """

        def receive(query: zenoh.Query) -> None:
            question = query.payload.to_bytes() if query.payload is not None else b""
            on_question(question, lambda answer: query.reply(key, answer))

        queryable = self._session.declare_queryable(
            key, zenoh.handlers.Callback(receive, indirect=False)
        )
        return queryable.undeclare

    def serve(self, keys: str, on_question: Callable[[str, bytes, OnBytes], None]) -> None:
        """Call `on_question` with key, query and reply function, for every key under a wildcard.

        The rules of `answer` apply; without a reply in time the client gets None.
        """

        def receive(query: zenoh.Query) -> None:
            key = str(query.key_expr)
            question = query.payload.to_bytes() if query.payload is not None else b""

            def reply(answer: bytes) -> None:
                query.reply(key, answer)
                query.drop()  # type: ignore[no-untyped-call] # completes the query for the client

            on_question(key, question, reply)

        self._session.declare_queryable(keys, zenoh.handlers.Callback(receive, indirect=False))

    def hear(self, keys: str, on_bytes: Callable[[str, bytes], None]) -> None:
        """Call `on_bytes` with key and payload for every key under a wildcard, as `listen` does."""

        def receive(sample: zenoh.Sample) -> None:
            on_bytes(str(sample.key_expr), sample.payload.to_bytes())

        self._session.declare_subscriber(keys, zenoh.handlers.Callback(receive, indirect=False))

    def ask(
        self, key: str, question: bytes, timeout_s: float, still: Callable[[], bool] = lambda: True
    ) -> bytes | None:
        """Return the reply to a query; None when the deadline passes or `still` returns False.

        Retry until then, also while no process serves that key yet.
        """
        deadline = time.monotonic() + timeout_s
        while (left_s := deadline - time.monotonic()) > 0 and still():
            for reply in self._session.get(key, payload=question or None, timeout=left_s):
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
            time.sleep(AGAIN_S)
        return None

    def ask_all(
        self, keys: str, question: bytes, timeout_s: float,
        enough: Callable[[Mapping[str, bytes]], bool],
    ) -> dict[str, bytes]:  # fmt: skip
        """Return all replies under a wildcard by key, until `enough` returns True or time is up."""
        found: dict[str, bytes] = {}
        deadline = time.monotonic() + timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            for reply in self._session.get(keys, payload=question or None, timeout=left_s):
                if reply.ok is not None:
                    found[str(reply.ok.key_expr)] = reply.ok.payload.to_bytes()
                if enough(found):
                    return found
            time.sleep(AGAIN_S)
        return found

    def close(self) -> None:
        """Leave the bus and remove the socket files, which Zenoh leaves behind."""
        self._session.close()  # type: ignore[no-untyped-call]
        for file in self._files:
            file.unlink(missing_ok=True)


class _Sender:
    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher
        self._matching = bool(publisher.matching_status.matching)  # type: ignore[attr-defined]
        note = zenoh.handlers.Callback(self._note, indirect=False)
        self._listener = publisher.declare_matching_listener(note)

    def send(self, payload: bytes) -> None:
        self._publisher.put(payload)

    def matching(self) -> bool:
        return self._matching

    def _note(self, status: Any) -> None:
        self._matching = bool(status.matching)


_COMMON: dict[str, object] = {
    "mode": "peer",
    "scouting": {
        "multicast": {"enabled": False},
        "gossip": {"enabled": True, "autoconnect": {"peer": ["router", "peer"]}},
    },
}
_TRANSPORT: dict[str, object] = {
    "shared_memory": {"enabled": False},
    # an express message takes a whole batch; the default of two overflows while the
    # transport's thread waits a few milliseconds for a core
    "link": {"tx": {"queue": {"size": {"data": 16, "real_time": 16}}}},
}


def _hasten(event: zenoh.LinkEvent) -> None:
    if event.kind == zenoh.SampleKind.PUT:
        hasten(event.link.src, event.link.dst)


def silence() -> None:
    """Stop Zenoh from printing in this process, for commands whose output is a result.

    Call it before the first session. A user's RUST_LOG takes precedence.
    """
    zenoh.init_log_from_env_or("off")


def _open(config: dict[str, object], what: str) -> zenoh.Session:
    zenoh.init_log_from_env_or(LOGGED)
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except BaseException as error:
        if not isinstance(error, zenoh.ZError) and type(error).__name__ != PANIC:
            raise
        raise RunError(f"{what}: {reason(error)}") from error


def reason(error: BaseException) -> str:
    """Return Zenoh's reason why a session cannot be opened, without its source lines.

    >>> reason(ValueError("no such host at /build/zenoh/src/unicast.rs:356."))
    'no such host'
    """
    said = _SOURCE_LINE.sub("", str(error))
    return f"{said}; another process listens there" if _TAKEN.search(said) else said
