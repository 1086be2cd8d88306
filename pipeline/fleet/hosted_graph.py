"""One host's part of a graph: start, supervision, topology changes and stop.

Its supervisor runs in its own thread and communicates with the other hosts. Added nodes are checked
like deployed ones. Edges between hosts cannot change, since both hosts have opened sessions for
them; therefore a change affects only one host.
"""

import hashlib
import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import msgspec

from pipeline.bus.clocks import Clocks
from pipeline.bus.network import Network
from pipeline.bus.session import Session
from pipeline.codec import to_bytes
from pipeline.errors import FoveaError, RunError
from pipeline.fleet.agent_file import GraphStore
from pipeline.fleet.names import connected
from pipeline.fleet.peers import Peer, Replication, Sessions, adopt
from pipeline.fleet.placement import partners
from pipeline.graph.plan import Edge, Plan
from pipeline.graph.ports import Ports
from pipeline.node.wiring import CLOCKS
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import ControlMessage, decode, encode, refused
from pipeline.protocol.fleet import Accounts
from pipeline.protocol.orders import RESULT, PlanOrder, Refused, SwapOrder
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.reaper import Reaper
from pipeline.run.supervisor import Supervisor
from pipeline.run.swap_target import swapped
from pipeline.text import error_text

WAIT_FOR_OTHERS_S = 60.0  # after this time, sources begin without the other hosts
TELL_S = 0.004  # interval of sending accounts, on which credit of lossless edges depends
TELL_IDLE_S = 0.02  # the same where nothing has changed for `IDLE_S`
IDLE_S = 0.1
ANYWAY_S = 0.25
END_S = 20.0  # stopping takes as long as the slowest operator's `close`
AGAIN_S = (1.0, 30.0)  # first and longest pause before a restart of a graph that has worked once
HEALTHY_S = 2 * AGAIN_S[1]  # after a run of this length the first pause applies again
HANGS_S = 30.0
STARTS_EPOCHS = 1000  # epochs per start of a host, to distinguish messages of former starts
log = logging.getLogger(__name__)
Inspected = tuple[Plan, Mapping[str, Ports]]  # what this host would run; ports by `module:Class`
Permit = Callable[[Plan, Mapping[str, str]], Inspected]  # raises for what may not run here
Ends = tuple[str, str, str, str]


@dataclass
class HostedGraph:
    """This host's part of a graph. Any thread may call `stop` and `end`."""

    plan: Plan
    ports: Mapping[str, Ports]  # of the operators here, which the agent does not import
    fingerprint: str  # of the requested graph; hosts with another one do not replicate
    networks: Mapping[str, Network]
    hosts: Mapping[str, str]  # of its partners: label -> end point of the agent
    way: Network  # network to those agents, without end points
    begins: Callable[[], int]  # increments a persistent count of starts
    reaper: Reaper | None = None  # of the agent
    phase: str = "starting"
    failure: str = ""
    supervisor: Supervisor | None = None
    clocks: Clocks = field(default_factory=Clocks)  # of all hosts, while it runs
    peers: dict[str, Peer] = field(default_factory=dict)
    orders: set[object] = field(default_factory=set)  # given, and what they change not yet stored
    _began_s: float = 0.0
    _proven: bool = False  # it has worked once, so that it is restarted when it fails
    _stop: threading.Event = field(default_factory=threading.Event)
    _in_haste: bool = False
    _thread: threading.Thread | None = None

    @property
    def folder(self) -> str:
        """The name of its run folder."""
        return f"{self.plan.name}@{self.plan.here}"

    @property
    def alive(self) -> bool:
        """Whether it runs, is starting or will be restarted."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def works(self) -> bool:
        """Whether every process of it runs."""
        supervisor = self.supervisor
        return self.phase == "running" and supervisor is not None and supervisor.manager.all_going

    @property
    def hangs(self) -> bool:
        """Whether nobody has looked after its processes for `HANGS_S`."""
        supervisor = self.supervisor
        return supervisor is not None and supervisor.health.ticked_ago_s > HANGS_S

    def begin(self) -> None:
        """Start its thread."""
        self._thread = threading.Thread(target=self._run, name=f"graph-{self.plan.name}")
        self._thread.start()

    def stop(self) -> None:
        """Request a stop."""
        self._stop.set()

    def hurry(self) -> None:
        """Request a stop without waiting for operators."""
        self._in_haste = True
        self.stop()

    def end(self) -> None:
        """Stop and wait; raises `RunError` after a timeout."""
        self.stop()
        if self._thread is not None:
            self._thread.join(END_S)
            if self._thread.is_alive():
                raise RunError(f"{self.plan.name}: did not end within {END_S:.0f} s")

    def hear(self, label: str, accounts: Accounts) -> None:
        """Receive another host's accounts."""
        if (peer := self.peers.get(label)) is not None:
            peer.hear(accounts)

    def fail(self, why: str) -> None:
        """Record why it does not run."""
        self.phase, self.failure = "failed", why
        log.error("%s: %s", self.plan.name, why)

    def _run(self) -> None:
        pause_s = AGAIN_S[0]
        while not self._stop.is_set():
            began_s = time.monotonic()
            self._run_once()
            if time.monotonic() - began_s > HEALTHY_S:
                pause_s = AGAIN_S[0]
            if not self._proven or self._stop.wait(pause_s):
                return
            pause_s = min(2 * pause_s, AGAIN_S[1])

    def _run_once(self) -> None:
        self.phase = "starting"
        try:
            starts = self.begins()
            self._proven = self._proven or starts > 1
            supervisor = Supervisor(
                self.plan, folder=self.folder, first_epoch=starts * STARTS_EPOCHS,
                may_go=self._may_go, reaper=self.reaper, ports=self.ports,
            )  # fmt: skip
            with supervisor:
                self._begin_clocks(supervisor)
                self._keep(supervisor, starts)
            self.phase = "stopped"
        except FoveaError as error:
            self.fail(str(error))
        except Exception as error:
            log.exception("%s: its supervisor failed", self.plan.name)
            self.fail(f"{type(error).__name__}: {error}")
        finally:
            self.supervisor = None

    def _begin_clocks(self, supervisor: Supervisor) -> None:
        self._began_s = time.monotonic()
        path = supervisor.manager.run_folder.folder.path / CLOCKS
        try:
            self.clocks = Clocks.create(path, self.plan.here, self.plan.hosts)
        except OSError as error:
            raise RunError(f"{CLOCKS}: cannot be made: {error.strerror}") from error

    def _may_go(self, managed: ManagedProcess) -> bool:
        """Whether sources may begin: the other hosts are ready, or the wait is over."""
        waited = time.monotonic() - self._began_s > WAIT_FOR_OTHERS_S
        others = all(n.replication.other_ready or n.lost for n in self.peers.values())
        return not managed.sources or waited or others

    def _keep(self, supervisor: Supervisor, starts: int) -> None:
        supervisor.manager.networks = dict(self.networks)
        supervisor.manager.asked_to_end = lambda: self._stop.is_set() + self._in_haste
        graph, done = self.plan.name, threading.Event()
        self.peers = {}
        points = {label: connected(point) for label, point in self.hosts.items()}
        sessions = Sessions(self._opened, points.values())
        telling = threading.Thread(target=self._tell, args=(supervisor, done), name=f"tell-{graph}")
        try:
            for label, point in points.items():
                replication = Replication(
                    self.plan, supervisor.ledger, label, starts, self.fingerprint
                )
                reading = self.clocks.readings[label]
                self.peers[label] = Peer(
                    graph, self.plan.here, replication, reading, sessions, point
                )
            if starts > 1:
                told = [n.recall() for n in self.peers.values()]
                mine = [t for t in told if t is not None and t.fingerprint == self.fingerprint]
                adopt(self.plan, supervisor.ledger, mine)
            self.supervisor = supervisor
            for peer in self.peers.values():
                peer.begin()
            telling.start()
            self._supervise(supervisor)
        finally:
            done.set()
            if telling.is_alive():
                telling.join()
            for peer in self.peers.values():
                peer.close()
            sessions.close()

    def _opened(self, points: tuple[str, ...]) -> Session:
        return Session.across(replace(self.way, connect=points))

    def _supervise(self, supervisor: Supervisor) -> None:
        supervisor.manager.begin_all()
        while not self._stop.is_set():
            supervisor.tick()
            broken = [n.broken for n in self.peers.values() if n.broken]
            if supervisor.failure or broken:
                raise RunError(supervisor.failure or broken[0])
            if self.phase == "starting" and supervisor.manager.all_going:
                self.phase, self.failure, self._proven = "running", "", True
                log.info("%s: %d processes run", self.plan.name, len(supervisor.processes))

    def _tell(self, supervisor: Supervisor, done: threading.Event) -> None:
        anyway_s = changed_s = 0.0
        try:
            while not done.wait(TELL_S if time.monotonic() - changed_s < IDLE_S else TELL_IDLE_S):
                now_s, ready = time.monotonic(), _is_ready(supervisor)
                anyway = now_s - anyway_s > ANYWAY_S
                anyway_s = now_s if anyway else anyway_s
                told = [peer.tell(ready=ready, anyway=anyway) for peer in self.peers.values()]
                if any(told) and not anyway:
                    changed_s = now_s
        except Exception as error:
            log.exception("%s: accounts are no longer sent", self.plan.name)
            supervisor.manager.failure = f"accounts are no longer sent: {error_text(error)}"


def _is_ready(supervisor: Supervisor) -> bool:
    """Whether every process here has opened its operators."""
    return all(managed.handle and managed.handle.ready for managed in supervisor.processes.values())


def planned(hosted: HostedGraph, store: GraphStore) -> wire.Planned:
    """Return the plan that this host runs, and its revision.

    Raises `RunError` while an order changes it: an edit of the plan of before, with the revision of
    after, would undo that order.
    """
    name, supervisor = hosted.plan.name, hosted.supervisor
    if supervisor is None:
        raise RunError(f"{name}: is not running now, try again")
    revision = supervisor.revision
    busy = bool(hosted.orders)  # after the revision: an order that ends between them changes it
    plan = store.asked(name).plan
    if busy or hosted.orders or supervisor.revision != revision:
        raise RunError(f"{name}: is being changed, try again")
    return wire.Planned(plan, revision)


def change(
    hosted: HostedGraph, asked: wire.PlanChange, store: GraphStore, permit: Permit,
    reply: Callable[[bytes], None],
) -> None:  # fmt: skip
    """Change this host's part of the graph and reply when done; raises `FoveaError`."""
    name, supervisor = hosted.plan.name, hosted.supervisor
    if supervisor is None:
        raise RunError(f"{name}: is not running now, try again")
    before = store.asked(name)
    check_inside(before.plan, asked.plan, hosted.plan.here)
    known = {**before.fingerprints, **asked.fingerprints}
    origins = {edge.origin for edge in asked.plan.edges}  # keeps the stored state bounded
    fingerprints = {origin: said for origin, said in known.items() if origin in origins}
    local, ports = permit(asked.plan, fingerprints)
    start = msgspec.structs.replace(
        before, plan=asked.plan, fingerprints=fingerprints, identity=identity_of(before)
    )

    def keep() -> None:
        hosted.plan, hosted.ports = local, ports
        store.keep(name, start)

    order = PlanOrder(plan=local, revision=asked.revision)
    carry_out(hosted, supervisor, order, keep, reply)


def keep_swap(
    hosted: HostedGraph, supervisor: Supervisor, asked: SwapOrder, local: SwapOrder,
    store: GraphStore,
) -> None:  # fmt: skip
    """Store what a swap has changed, so that no restart undoes it; raises `FoveaError`.

    `asked` is the order as it came and `local` the one with this host's files and settings, which
    a stored plan does not contain. Nor does it contain live changes.
    """
    plan = swapped(hosted.plan, local, {})
    operator = plan.node(local.node).operator
    ports = supervisor.manager.ports_of(plan.node(local.node))
    hosted.plan, hosted.ports = plan, {**hosted.ports, operator: ports}
    before = store.asked(plan.name)
    after = swapped(before.plan, asked, {})
    store.keep(plan.name, msgspec.structs.replace(before, plan=after, identity=identity_of(before)))


def carry_out(
    hosted: HostedGraph, supervisor: Supervisor, order: PlanOrder | SwapOrder,
    keep: Callable[[], None], reply: Callable[[bytes], None],
) -> None:  # fmt: skip
    """Carry out an order, `keep` what it has changed on the supervisor's thread, and reply."""
    pending = object()

    def done(result: bytes) -> None:
        try:
            if not isinstance(decode(RESULT, result), Refused):
                keep()
            said: ControlMessage = wire.Relayed(result)
        except FoveaError as error:
            said = refused(f"it was changed, but a restart will lose it: {error}")
        finally:
            hosted.orders.discard(pending)  # before the reply: the client may go on at once
        reply(encode(said))

    hosted.orders.add(pending)
    try:
        supervisor.control.ask(encode(order), done)
    except BaseException:
        hosted.orders.discard(pending)
        raise


def check_inside(before: Plan, wanted: Plan, label: str) -> None:
    """Raise `RunError` for a change of other hosts' nodes, or of edges between hosts."""
    if replace(before, nodes=wanted.nodes, edges=wanted.edges) != wanted:
        raise RunError(f"{before.name}: expected another plan of the same graph")
    elsewhere = [[n for n in plan.nodes if n.host != label] for plan in (before, wanted)]
    if elsewhere[0] != elsewhere[1]:
        raise RunError(f"{before.name}: expected the nodes of other hosts as they are")
    beyond = [
        {(ends_of(e), e) for e in plan.edges if not is_inside(plan, e, label)}
        for plan in (before, wanted)
    ]
    if beyond[0] != beyond[1]:
        raise RunError(f"{before.name}: expected the edges of other hosts as they are")
    known = partners(before)
    for host, others in partners(wanted).items():
        if strange := sorted(others - known.get(host, frozenset())):
            raise RunError(
                f"{before.name}: exposures would pass between {host} and {strange[0]}, which do "
                "not know one another's clocks; deploy the graph again with --replace"
            )


def is_inside(plan: Plan, edge: Edge, label: str) -> bool:
    """Whether both ends of an edge are on a host."""
    return plan.node(edge.source).host == label == plan.node(edge.target).host


def ends_of(edge: Edge) -> Ends:
    """Return the ends of an edge."""
    return edge.source, edge.output, edge.target, edge.input


def identity_of(start: wire.Start) -> str:
    """Return a deployed graph's identity among hosts, which topology changes keep."""
    return start.identity or hashlib.sha256(to_bytes(start.plan)).hexdigest()[:16]
