"""Bytes between processes: the only file that knows Zenoh.

Every node listens on a unix socket of its own in a private directory and connects to the hub (the
supervisor's session); gossip then gives the peers direct links. Only a session `across` hosts
listens on a network, no multicast is sent, and Zenoh's own shared memory is off: frames travel
through `pipeline.bus.pool`.
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
LOGGED = "error,zenoh::net::protocol::gossip=off"  # which mistakes a peer that leaves for a fault
PANIC = "PanicException"  # how Rust fails without descriptors or threads; it has no other name here
_SOURCE_LINE = re.compile(r" at /\S+\.rs:\d+\.?")  # where Zenoh was compiled
_TAKEN = re.compile("acquire lock|in use", re.IGNORECASE)
AGAIN_S = 0.05  # a new session does not know at once who answers


class Sender(Protocol):
    """One key's writing end."""

    def send(self, payload: bytes) -> None:
        """Hand over to the transport; waits for a reader only where the session has a timeout."""
        ...

    def matching(self) -> bool:
        """Whether anybody subscribes."""
        ...


class Session:
    """A peer of the graph's bus. Close it before the process ends, or Zenoh keeps it alive."""

    def __init__(
        self, folder: Path, name: str, *, hub: str = "hub", timeout_s: float = 10.0,
        guest: bool = False,
    ) -> None:  # fmt: skip
        """`timeout_s`: how long a frozen peer may keep this one from opening or closing a link.

        A `guest` listens nowhere: it leaves no socket behind, however it ends, and no other process
        ever waits for it to open a link.
        """
        self._files: tuple[Path, ...] = ()
        if name != hub and not guest:  # the hub's go with the run's folder
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
        """Open a session with other hosts; it does not wait for any of them."""
        session = cls.__new__(cls)
        session._files = ()
        session._session = _open(network.config(), ", ".join(network.listen) or "network")
        session._session.info.declare_link_events_listener(
            zenoh.handlers.Callback(_hasten, indirect=False), history=True
        )
        return session

    def sender(self, key: str, *, urgent: bool = False, patient: bool = False) -> Sender:
        """A publisher; `urgent` ones (sensor commands) overtake everything else.

        Descriptors are small and the runtime's own credit bounds them: a queue can only fill behind
        a reader that stopped, and waiting for it would stop the others too. Whole pictures need a
        `patient` sender, which waits for the link.
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
        """Call `on_bytes` from the transport's thread for every payload; returns the way to stop.

        It must be quick and must not call the bus.
        """

        def receive(sample: zenoh.Sample) -> None:
            on_bytes(sample.payload.to_bytes())

        subscriber = self._session.declare_subscriber(
            key, zenoh.handlers.Callback(receive, indirect=False)
        )
        return subscriber.undeclare

    def answer(self, key: str, on_question: OnQuestion) -> Callable[[], None]:
        """Call `on_question` from the transport's thread for every question; returns how to stop.

        It must be quick; the reply may be given later, by any thread, at most once.
        """

        def receive(query: zenoh.Query) -> None:
            question = query.payload.to_bytes() if query.payload is not None else b""
            on_question(question, lambda answer: query.reply(key, answer))

        queryable = self._session.declare_queryable(
            key, zenoh.handlers.Callback(receive, indirect=False)
        )
        return queryable.undeclare

    def serve(self, keys: str, on_question: Callable[[str, bytes, OnBytes], None]) -> None:
        """Call `on_question` with key, question and how to reply, for every key under a wildcard.

        As for `answer`; without a reply within the asker's timeout it gets nothing.
        """

        def receive(query: zenoh.Query) -> None:
            key = str(query.key_expr)
            question = query.payload.to_bytes() if query.payload is not None else b""

            def reply(answer: bytes) -> None:
                query.reply(key, answer)
                query.drop()  # type: ignore[no-untyped-call] # the asker hears the answer when no other can come

            on_question(key, question, reply)

        self._session.declare_queryable(keys, zenoh.handlers.Callback(receive, indirect=False))

    def hear(self, keys: str, on_bytes: Callable[[str, bytes], None]) -> None:
        """Call `on_bytes` with key and payload of everything under a wildcard; as for `listen`."""

        def receive(sample: zenoh.Sample) -> None:
            on_bytes(str(sample.key_expr), sample.payload.to_bytes())

        self._session.declare_subscriber(keys, zenoh.handlers.Callback(receive, indirect=False))

    def ask(
        self, key: str, question: bytes, timeout_s: float, still: Callable[[], bool] = lambda: True
    ) -> bytes | None:
        """Return the answer to a question; None when the deadline passes, or `still` is false.

        Retries until then, also while nothing answers at that key yet.
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
        """Return all answers under a wildcard, by key; until `enough` is true or time is up."""
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
        """Leave the bus; Zenoh would leave the files of its socket behind."""
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
    # an express message takes a batch of its own; two, the default, overflow while the
    # transport's thread waits a few milliseconds for a core
    "link": {"tx": {"queue": {"size": {"data": 16, "real_time": 16}}}},
}


def _hasten(event: zenoh.LinkEvent) -> None:
    if event.kind == zenoh.SampleKind.PUT:
        hasten(event.link.src, event.link.dst)


def silence() -> None:
    """Let Zenoh print nothing in this process: for commands, whose standard output is an answer.

    It goes before the first session; RUST_LOG, where it is set, has the last word.
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
    """What Zenoh says of a session that cannot be opened, without lines of its source.

    >>> reason(ValueError("no such host at /build/zenoh/src/unicast.rs:356."))
    'no such host'
    """
    said = _SOURCE_LINE.sub("", str(error))
    return f"{said}; another process listens there" if _TAKEN.search(said) else said
