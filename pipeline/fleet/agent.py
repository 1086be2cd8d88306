"""`fovea agent`: runs on a host and runs its part of graphs that known users deploy.

Each client has its own key, which the access list binds to its certificate. The main thread answers
questions about graphs, another thread starts and stops them.
"""

import logging
import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pipeline.bus.network import Network
from pipeline.bus.session import Session
from pipeline.errors import FoveaError, MessageError, RunError
from pipeline.fleet.agent_file import GraphStore, HostConfig
from pipeline.fleet.hosted_graph import HostedGraph, Inspected, change, identity_of, planned
from pipeline.fleet.inspection import Inspector, NotInspected
from pipeline.fleet.links import (
    agent_permits,
    asker_permits,
    check_credentials,
    end_points,
    local_end_points,
    networks,
    own_end_points,
)
from pipeline.fleet.names import (
    ANYBODY,
    ROUTER,
    agent_key,
    connected,
    endpoint,
    endpoint_host,
    host_identity,
    is_routed,
    region_of,
)
from pipeline.fleet.placement import DIGEST_PREFIX, partners, permitted
from pipeline.fleet.questions import Question, Questions
from pipeline.fleet.relay import NodeGateway, TapRelay, check_here
from pipeline.fleet.status import state_of
from pipeline.graph.plan import Plan
from pipeline.naming import check_name
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import ControlMessage, decode
from pipeline.protocol.fleet import Named, Prepare, Prepared, Start
from pipeline.run.logs import log_part
from pipeline.run.reaper import Reaper

MOST_GRAPHS = 8
MOST_LINES = 1000
RESUME_ATTEMPTS = 3
Act = Callable[[bytes], ControlMessage | None]
log = logging.getLogger(__name__)


class Agent:
    """The agent of a host. Leaving its context stops the graphs, which resume at the next start."""

    def __init__(self, own: HostConfig, reaper: Reaper | None = None) -> None:
        """`reaper`: of this process, if it may adopt orphans of nodes."""
        self.host, self.label, self._reaper = own, own.label, reaper
        self._credentials = own.credentials
        self._allowed = own.allowed
        self._gateway = NodeGateway(self._allowed, own.file.settings)
        self._taps = TapRelay()
        self._questions = Questions()
        self.hosted: dict[str, HostedGraph] = {}
        self._stop = threading.Event()
        own.state.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._store = GraphStore(own.state)
        self._inspector = Inspector(own.state, self._stop.is_set, reaper)
        self._identities = own.identities if self._credentials else (ANYBODY, *own.identities)
        permits = agent_permits(self.label, self._identities, ROUTER if own.router else "")
        self._session = Session.across(self._network(permits=permits, **self._place()))
        self._served: set[str] = set()
        for identity in self._identities:
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

    def _network(self, **more: Any) -> Network:
        credentials = str(self._credentials.folder) if self._credentials else ""
        region = region_of(host_identity(self.label)) if self.host.router else ""
        return Network(credentials=credentials, region=region, **more)

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
        asked = decode(Prepare, data)
        self._check_versions(asked.versions)
        plan = asked.plan
        missing = self._missing(plan)
        if missing:
            return Prepared({}, missing)
        self._check_free(plan, replace=asked.replace)
        local = self._permitted(plan)
        self._inspector.prepare(local, asked.fingerprints, self._allowed.files_of(local))
        return Prepared(self._free_end_points(local))

    def _start(self, data: bytes) -> wire.Accepted:
        asked = decode(Start, data)
        hosted = self._hosted_of(asked)  # before any running graph is touched
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
        self._check_versions(asked.versions)
        hosted = self._hosted(asked.graph)
        change(hosted, asked, self._store, self._inspected, question.reply)

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

    def _missing(self, plan: Plan) -> tuple[str, ...]:
        here = [n for n in plan.nodes if n.host == self.label]
        return tuple(dict.fromkeys(d for n in here for d in self._allowed.missing(n.settings)))

    def _check_free(self, plan: Plan, *, replace: bool) -> None:
        hosted = self.hosted.get(plan.name)
        if hosted is not None and hosted.alive and not replace:
            raise RunError(f"{plan.name}: runs already; take it down first, or use --replace")
        if hosted is None and len(self.hosted) >= MOST_GRAPHS:
            raise RunError(f"{plan.name}: expected up to {MOST_GRAPHS} graphs on a host, got more")

    def _check_versions(self, theirs: wire.Versions) -> None:
        if theirs != (ours := wire.Versions.ours()):
            raise RunError(f"expected {theirs}, got {ours} here")

    def _inspected(self, plan: Plan, fingerprints: Mapping[str, str]) -> Inspected:
        local = self._permitted(plan)
        files = self._allowed.files_of(local)
        return local, self._inspector.begin(local, fingerprints, files)

    def _permitted(self, plan: Plan) -> Plan:
        local = permitted(plan, self.label, self._allowed, self.host.file.settings)
        check_credentials(local, self._credentials)
        return local

    def _hosted_of(self, asked: Start) -> HostedGraph:
        """Return the requested graph, checked but not started."""
        self._check_versions(asked.versions)
        plan = asked.plan
        self._check_free(plan, replace=True)
        self._check_partners(plan, asked)
        local, ports = self._inspected(plan, asked.fingerprints)
        own = own_end_points(local, self._free_end_points(local), asked.endpoints)
        self._check_unused(local, own)
        identity = host_identity(self.label)
        others = sorted(partners(local)[self.label])
        points = {label: self._reached(label, asked.hosts[label]) for label in others}
        for other in others:
            self._serve(host_identity(other))
        return HostedGraph(
            plan=local,
            ports=ports,
            fingerprint=identity_of(asked),
            networks=networks(local, own, asked.endpoints, self._credentials, self.host.router),
            hosts=points,
            way=self._network(permits=asker_permits(identity, points)),
            begins=partial(self._store.count, local.name),
            reaper=self._reaper,
        )

    def _reached(self, label: str, address: str) -> str:
        """Return the end point of another host; behind a router it is this host's own router.

        Raises `RunError` unless both are behind a router or neither is.
        """
        point = endpoint(address, "hosts")
        if is_routed(point) != bool(self.host.router):
            behind, other = (label, self.label) if is_routed(point) else (self.label, label)
            raise RunError(
                f"{behind} is behind a router and {other} is not: expected every host of a graph "
                "behind it, or none"
            )
        return self.host.router or point

    def _check_partners(self, plan: Plan, asked: Start) -> None:
        for label, point in asked.hosts.items():
            check_name(label, "hosts")
            if self._credentials and host_identity(label) not in self._identities:
                raise RunError(f"{label} is not among the hosts that this one may contact")
            endpoint(point, "hosts")
        others = partners(plan).get(self.label, frozenset())
        if others - set(asked.hosts):
            raise RunError(f"{plan.name}: no address for host {min(others - set(asked.hosts))}")
        for point in asked.endpoints.values():
            endpoint(point, "endpoints")

    def _free_end_points(self, local: Plan) -> dict[str, str]:
        """Return free end points for local processes with edges to other hosts."""
        if self.host.router:  # its processes connect to it, and nothing listens here
            return {}
        if self._credentials is None:
            return local_end_points(local)
        first, last = self.host.file.ports
        used = self._used(local.name)
        return end_points(local, endpoint_host(self.host.endpoint), range(first, last + 1), used)

    def _used(self, but: str) -> set[str]:
        """Return the end points of the other graphs here."""
        others = [other for graph, other in list(self.hosted.items()) if graph != but]
        return {p for o in others for network in o.networks.values() for p in network.listen}

    def _check_unused(self, local: Plan, own: Mapping[str, str]) -> None:
        """Raise `RunError` for an end point that is not this host's, or already in use."""
        if self._credentials is None or self.host.router:
            return
        first, last = self.host.file.ports
        host = endpoint_host(self.host.endpoint)
        mine = {f"tls/{host}:{port}" for port in range(first, last + 1)} - self._used(local.name)
        if strange := sorted(set(own.values()) - mine):
            raise RunError(f"{local.name}: {strange[0]} is not free here any more, try again")

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
                return self._hosted_of(asked)
            except NotInspected as error:
                log.warning("%s; trying again", error)
        return self._hosted_of(asked)
