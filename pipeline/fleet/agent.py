"""`fovea agent`: runs on a host and runs its part of graphs that known users deploy.

Each client has its own key, which the access list binds to its certificate. The main thread answers
questions about graphs, another thread starts and stops them.
"""

import logging
import threading
from collections.abc import Callable, Mapping
from functools import partial

from pipeline.bus.session import Session
from pipeline.errors import FoveaError, MessageError, RunError
from pipeline.fleet.admission import Admission, check_versions
from pipeline.fleet.agent_file import GraphStore, HostConfig
from pipeline.fleet.hosted_graph import HostedGraph, change, planned
from pipeline.fleet.inspection import Inspector, NotInspected
from pipeline.fleet.links import agent_permits
from pipeline.fleet.names import ROUTER, agent_key, connected, host_identity
from pipeline.fleet.placement import DIGEST_PREFIX
from pipeline.fleet.questions import Question, Questions
from pipeline.fleet.relay import NodeGateway, TapRelay, check_here
from pipeline.fleet.status import state_of
from pipeline.naming import check_name
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import ControlMessage, decode
from pipeline.protocol.fleet import Named, Prepare, Prepared, Start
from pipeline.run.heartbeat import Heartbeat
from pipeline.run.logs import log_part
from pipeline.run.reaper import Reaper

MOST_LINES = 1000
RESUME_ATTEMPTS = 3
Act = Callable[[bytes], ControlMessage | None]
log = logging.getLogger(__name__)


class Agent:
    """The agent of a host. Leaving its context stops the graphs, which resume at the next start."""

    def __init__(
        self, own: HostConfig, reaper: Reaper | None = None, heartbeat: Heartbeat | None = None
    ) -> None:
        """`reaper`: of this process, if it may adopt orphans of nodes."""
        self.host, self.label = own, own.label
        self._allowed = own.allowed
        self._taps = TapRelay()
        self._questions = Questions()
        self.hosted: dict[str, HostedGraph] = {}
        self._heartbeat = heartbeat or Heartbeat(None)
        self._stop = threading.Event()
        own.state.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._store = GraphStore(own.state)
        self._gateway = NodeGateway(self._allowed, own.file.settings, self._store)
        inspector = Inspector(own.state, self._stop.is_set, reaper)
        self._admission = Admission(own, self._allowed, inspector, self._store, self.hosted, reaper)
        identities = self._admission.identities
        permits = agent_permits(self.label, identities, ROUTER if own.router else "")
        self._session = Session.across(self._admission.network(permits=permits, **self._place()))
        self._served: set[str] = set()
        for identity in identities:
            if not identity.startswith(host_identity("")):  # hosts: once they share a graph with it
                self._serve(identity)

    def __enter__(self) -> "Agent":
        return self

    def __exit__(self, *_: object) -> None:
        for hosted in self.hosted.values():
            hosted.stop()
        for hosted in self.hosted.values():
            self._guarded(hosted.end)
        self._gateway.close()
        self._taps.close()
        self._session.close()

    def stop(self) -> None:
        """Make `run` return; a second call does not wait for operators."""
        if self._stop.is_set():
            for hosted in list(self.hosted.values()):
                hosted.hurry()
        self._stop.set()

    def run(self) -> None:
        """Resume the former graphs, then answer questions until stopped."""
        worker = threading.Thread(target=self._work, name="works")
        worker.start()
        how = "is reached through" if self.host.router else "listens at"
        log.info("host %s %s %s", self.label, how, self.host.endpoint)
        self._answer_all(slow=False)
        worker.join()

    def _work(self) -> None:
        for name in self._store.names():
            if not self._stop.is_set():
                self._guarded(partial(self._resume, name))
        self._answer_all(slow=True)

    def _answer_all(self, *, slow: bool) -> None:
        while not self._stop.is_set():
            self._guarded(partial(self._answer_next, slow))
            if not slow:
                self._beat()

    def _beat(self) -> None:
        graphs = list(self.hosted.values())
        if not any(hosted.hangs for hosted in graphs):
            self._heartbeat.beat(works=all(hosted.works for hosted in graphs))

    def _answer_next(self, slow: bool) -> None:
        if not self._questions.answer_next(self._answer, slow=slow):
            self._taps.tidy()

    def _guarded(self, act: Callable[[], None]) -> None:
        try:
            act()
        except Exception as error:
            log.exception("host %s: %s", self.label, error)

    def _place(self) -> dict[str, tuple[str, ...]]:
        """Return where its own session listens, or to which router it connects."""
        if self.host.router:
            return {"connect": (connected(self.host.router),)}
        return {"listen": (self.host.endpoint,)}

    def _serve(self, identity: str) -> None:
        """Start answering an identity."""
        if identity in self._served:
            return
        self._served.add(identity)
        keys = agent_key(self.label, identity, "**")
        self._session.serve(keys, partial(self._questions.put, identity))
        if identity.startswith("host."):
            self._session.hear(keys, partial(self._told, identity.removeprefix("host.")))

    def _told(self, label: str, key: str, data: bytes) -> None:
        """Receive another host's accounts, on the transport's thread."""
        hosted = self.hosted.get(key.rpartition("/")[2])
        if hosted is None:
            return
        try:
            hosted.hear(label, decode(wire.Accounts, data))
        except MessageError as error:
            self._questions.warn_once(f"accounts of {label}: {error}")

    def _answer(self, question: Question) -> ControlMessage | None:
        """Return the reply; None if another thread will send it."""
        verbs: Mapping[str, Act] = {
            "about": self._about, "prepare": self._prepare, "start": self._start,
            "down": self._down, "state": self._state, "log": self._log, "weights": self._weights,
            "lacks": self._lacks, "node": partial(self._node, question),
            "swap": partial(self._swap, question), "plan": self._plan,
            "replan": partial(self._replan, question), "tap": partial(self._tap, question),
        }  # fmt: skip
        of_hosts: Mapping[str, Act] = {"recall": partial(self._recall, question)}
        known = of_hosts if question.asker.startswith("host.") else verbs
        if question.verb not in known:
            raise RunError(f"{question.asker} may not {question.verb} here")
        return known[question.verb](question.data)

    def _about(self, data: bytes) -> wire.About:
        decode(wire.Nothing, data)
        return wire.About(self.label, wire.Versions.ours(), tuple(self.hosted))

    def _prepare(self, data: bytes) -> Prepared:
        return self._admission.prepared(decode(Prepare, data))

    def _start(self, data: bytes) -> wire.Accepted:
        asked = decode(Start, data)
        hosted = self._admitted(asked)  # before any running graph is touched
        if (before := self.hosted.get(hosted.plan.name)) is not None:
            before.end()
        self._store.keep(hosted.plan.name, asked)
        self.hosted[hosted.plan.name] = hosted
        hosted.begin()
        return wire.Accepted()

    def _down(self, data: bytes) -> wire.Accepted:
        graph = check_name(decode(Named, data).graph, "graph")
        hosted = self.hosted.get(graph)
        self._store.forget(graph)
        if hosted is None:
            raise RunError(f"no graph {graph} runs here")
        try:
            hosted.end()
        finally:  # a concurrent change may have stored it again
            self._store.forget(graph)
        del self.hosted[graph]
        return wire.Accepted()

    def _state(self, data: bytes) -> wire.States:
        graph = decode(Named, data).graph
        hosted = [h for name, h in list(self.hosted.items()) if graph in ("", name)]
        return wire.States(tuple(map(state_of, hosted)))

    def _log(self, data: bytes) -> wire.Log:
        asked = decode(wire.Lines, data)
        hosted = self._hosted(asked.graph)
        check_here(hosted, asked.node)
        count = max(0, min(asked.count, MOST_LINES))
        begin = None if asked.begin is None else max(0, asked.begin)
        return wire.Log(*log_part(hosted.folder, asked.node, count, begin))

    def _weights(self, data: bytes) -> wire.Accepted:
        return wire.Accepted(self._allowed.keep(data))

    def _lacks(self, data: bytes) -> wire.Missing:
        digests = decode(wire.Lacks, data).digests
        return wire.Missing(self._allowed.missing([DIGEST_PREFIX + d for d in digests]))

    def _node(self, question: Question, data: bytes) -> None:
        asked = decode(wire.ToNode, data)
        self._gateway.ask(self._hosted(asked.graph), asked, question.reply)

    def _swap(self, question: Question, data: bytes) -> None:
        asked = decode(wire.Change, data)
        self._gateway.swap(self._hosted(asked.graph), asked.order, question.reply)

    def _plan(self, data: bytes) -> wire.Planned:
        return planned(self._hosted(decode(Named, data).graph), self._store)

    def _replan(self, question: Question, data: bytes) -> None:
        asked = decode(wire.PlanChange, data)
        check_versions(asked.versions)
        hosted = self._hosted(asked.graph)
        change(hosted, asked, self._store, self._admission.inspected, question.reply)

    def _tap(self, question: Question, data: bytes) -> None:
        asked = decode(wire.TapQuestion, data)
        hosted = self._hosted(asked.graph)
        fetch = partial(self._taps.fetch, hosted, asked, question.asker)
        self._gateway.submit(fetch, question.reply)

    def _recall(self, question: Question, data: bytes) -> wire.Accounts:
        hosted = self._hosted(decode(Named, data).graph)
        peer = hosted.peers.get(question.asker.removeprefix("host."))
        if peer is None or hosted.supervisor is None:
            raise RunError(f"{hosted.plan.name}: nothing is shared with {question.asker}")
        return peer.replication.whole()

    def _hosted(self, graph: str) -> HostedGraph:
        if graph not in self.hosted:
            raise RunError(f"no graph {graph} runs here")
        return self.hosted[graph]

    def _resume(self, name: str) -> None:
        """Restart a graph that ran when the agent ended; on failure, the log has the reason."""
        asked = self._store.asked(name)
        try:
            hosted = self._resumed(asked)
        except FoveaError as error:
            log.error("%s: cannot resume: %s", name, error)
            return
        self.hosted[name] = hosted
        hosted.begin()
        log.info("%s: resumed", name)

    def _resumed(self, asked: Start) -> HostedGraph:
        """Return the graph to resume; while a machine starts, an inspection may take too long."""
        for _ in range(RESUME_ATTEMPTS - 1):
            try:
                return self._admitted(asked)
            except NotInspected as error:
                log.warning("%s; trying again", error)
        return self._admitted(asked)

    def _admitted(self, asked: Start) -> HostedGraph:
        """Return the requested graph, checked but not started, and begin to answer its partners."""
        hosted = self._admission.hosted_of(asked)
        for other in hosted.hosts:
            self._serve(host_identity(other))
        return hosted
