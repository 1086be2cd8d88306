"""The processes of a running graph, their accounts, and how they are started.

What supervises them, and what changes them while they run, stand on this.
"""

import logging
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from pathlib import Path

from pipeline.bus.ledger import EdgeAccount, Ledger
from pipeline.bus.network import Network
from pipeline.class_cache import adapter
from pipeline.errors import RunError
from pipeline.graph.plan import Node, Plan
from pipeline.graph.ports import Ports, declared_ports
from pipeline.node.port_contract import contract_of
from pipeline.protocol.supervision import Assignment, Finish, Go, Imported
from pipeline.run.channel import Exchange
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.process_handle import KILLED_S, NodeProcess, ProcessHandle, spawn
from pipeline.run.reaper import Reaper
from pipeline.run.run_folder import RunFolder
from pipeline.run.rundir import check_addresses, folder_of
from pipeline.run.warm_spare import WarmSpare

MayGo = Callable[[ManagedProcess], bool]
log = logging.getLogger(__name__)


def always(_managed: ManagedProcess) -> bool:
    """No process waits for anything but the readers of its sources."""
    return True


class ProcessManager:
    """The processes of one plan, in a run folder of their own."""

    def __init__(
        self, plan: Plan, *, frames: int = 0, folder: str = "", first_epoch: int = 0,
        may_go: MayGo = always, reaper: Reaper | None = None,
        ports: Mapping[str, Ports] | None = None,
    ) -> None:  # fmt: skip
        """`folder`: where it runs, else the graph's name; epochs begin after the first one.

        `may_go`: what a process that is ready waits for beyond the readers of its sources.
        `reaper`: of this process, if it may adopt what nodes leave behind. `ports`: of the plan's
        operators, by `module:Class`; without them the operators are imported.
        """
        self._may_go, self.reaper = may_go, reaper
        self.plan, self._frames, self._first_epoch = plan, frames, first_epoch
        self.networks: dict[str, Network] = {}  # by process, of those that reach other hosts
        names = [name for n in plan.nodes for name in (n.name, n.process)]
        check_addresses(folder_of(folder or plan.name), names)
        here = filter(plan.is_here, plan.nodes)  # what loaded the plan has imported them
        self._ports = dict(ports or {n.operator: declared_ports(n.operator) for n in here})
        self.run_folder = RunFolder.claim(folder or plan.name)
        try:
            self.ledger = Ledger.create(self.run_folder.memory, len(plan.edges), len(plan.nodes))
            self.exchange = Exchange()
        except BaseException:
            self.run_folder.release()
            raise
        self.handles: list[ProcessHandle] = []  # that were started, until all they said was heard
        self.leaving: dict[
            ProcessHandle, float
        ] = {}  # when those are killed that shall end, monotonic
        self.asked_to_end: Callable[[], int] = lambda: 0  # how often: more than once is in haste
        self.stop_orders = 0  # likewise, by clients
        self.spare = WarmSpare(partial(self._spawn, wanted=False))
        self.processes = {
            name: ManagedProcess(name, nodes, epoch=first_epoch, sources=self._sources_of(nodes))
            for name, nodes in plan.processes().items()
        }
        self.revision = 0  # of the plan
        self.exposing_since_s = 0.0  # since the first source began, monotonic
        self.failure = ""
        self.ending = False  # sources shall make no more frames
        self.finished_sources: set[str] = set()
        self.restarts: dict[str, int] = {}  # by process
        self.crashes: dict[str, int] = {}  # ends that were not asked for, by process

    @property
    def end_requests(self) -> int:
        """How often the run was asked to end."""
        return self.asked_to_end() + self.stop_orders

    @property
    def all_going(self) -> bool:
        """Every process works."""
        return all(managed.handle and managed.handle.going for managed in self.processes.values())

    @property
    def finished(self) -> bool:
        """Every source has made its last frame, or the run has failed."""
        wanted = self.source_names
        return bool(self.failure) or (bool(wanted) and wanted <= self.finished_sources)

    @property
    def source_names(self) -> frozenset[str]:
        """The nodes here that make frames."""
        return frozenset().union(*(managed.sources for managed in self.processes.values()))

    def begin_all(self) -> None:
        """Start every process; the caller goes on with `tick`."""
        for managed in reversed(self.processes.values()):
            if not self.end_requests:
                self.begin(managed)
        self.note()

    def begin(
        self, managed: ManagedProcess, *, plan: Plan | None = None, checked: bool = False
    ) -> None:
        """Start a process as its next incarnation; `checked`: of a plan that is still to prove."""
        managed.epoch = managed.promise()
        for node in managed.nodes:
            self.ledger.nodes[node.index].enter("starting")
        for account in self.accounts(managed, outgoing=True):
            account.writer_epoch = managed.epoch
        for account in self.accounts(managed):
            account.reader_epoch = account.receiver_epoch = managed.epoch
            account.next_receiver_epoch = 0
        job = self.job(managed, plan or self.plan, managed.epoch, checked=checked)
        managed.handle = self.launch(job, fresh=checked)

    def job(
        self,
        managed: ManagedProcess,
        plan: Plan,
        epoch: int,
        *,
        standby: bool = False,
        checked: bool = False,
        trial: bool = False,
    ) -> Assignment:
        """The assignment of that process; `checked`: it must fit the edges that run now."""
        mine = managed.nodes
        return Assignment(
            plan=plan,
            process=managed.name,
            run_folder=str(self.run_folder.folder.path),
            memory_folder=str(self.run_folder.memory.path),
            epochs={node.name: epoch for node in mine},
            frames=self._frames,
            network=self.networks.get(managed.name),
            standby=standby or trial,
            trial=trial,
            contracts={
                node.name: contract_of(self.plan, node, self.ports_of)
                for node in mine
                if (checked or trial) and node in self.plan.nodes
            },
        )

    def ports_of(self, node: Node) -> Ports:
        """The ports of a node's operator; raises `RunError` unless a process has told them."""
        try:
            return self._ports[node.operator]
        except KeyError:
            raise RunError(f"{node.name}: no process has imported {node.operator}") from None

    def learn(self, handle: ProcessHandle, imported: Imported) -> None:
        """Take note of what a process has imported: ports of its operators, files of its code."""
        for operator in handle.operators & imported.ports.keys():
            self._ports[operator] = imported.ports[operator]
        self.spare.watch(imported.files)

    def _sources_of(self, nodes: Iterable[Node]) -> frozenset[str]:
        return frozenset(node.name for node in nodes if self.ports_of(node).source)

    def accounts(self, managed: ManagedProcess, *, outgoing: bool = False) -> list[EdgeAccount]:
        """Of the edges into a process, or out of it."""
        names = {node.name for node in managed.nodes}
        return [
            self.ledger.edges[edge.index]
            for edge in self.plan.edges
            if (edge.source if outgoing else edge.target) in names
        ]

    def release(self) -> None:
        """Give the run folder and its memory back; every process must have ended."""
        self.run_folder.release()

    def vacate(self, managed: ManagedProcess) -> None:
        """Nobody works there now: writers do not wait for it."""
        if managed.handle is not None:
            self.dismiss(managed.handle)
        managed.handle = None
        for account in self.accounts(managed):
            account.reader_epoch = account.receiver_epoch = account.next_receiver_epoch = 0
        for node in managed.nodes:
            self.ledger.nodes[node.index].enter("absent")

    def live_file(self, node: str) -> Path:
        """Where a node keeps the settings that it was told while it ran."""
        return self.run_folder.folder.path / f"{node}.live"

    def change_plan(self, plan: Plan) -> None:
        """Another plan runs now; a process that left it must have ended."""
        self.plan, self.revision = plan, self.revision + 1
        for name, nodes in plan.processes().items():
            managed = self.processes.setdefault(name, ManagedProcess(name, nodes))
            managed.nodes = nodes
            managed.sources = self._sources_of(nodes)
        for name in self.processes.keys() - plan.processes().keys():
            if self.processes[name].handle is None:
                del self.processes[name]
        self.note()

    def launch(self, job: Assignment, *, fresh: bool = False) -> ProcessHandle:
        """A process for an assignment; a `fresh` one has imported what is on disk now.

        Raises `RunError` when the machine gives none.
        """
        if fresh:
            self.spare.refresh()
        mine = {n.operator.partition(":")[0] for n in job.nodes}
        try:
            process = self.spare.take() or self._spawn(mine if fresh else (), wanted=True)
        except OSError as error:
            raise RunError(f"{job.process}: cannot be started: {error}") from error
        handle = ProcessHandle(process, job, self.exchange)
        self.handles.append(handle)
        return handle

    def dismiss(self, handle: ProcessHandle, within_s: float = 0.0) -> None:
        """Let a process end by itself in that time, or be killed; nobody waits for it."""
        self.leaving[handle] = time.monotonic() + within_s
        self.see_off()

    def see_off(self) -> None:
        """Kill those that were to end by now, give back what is left of those that have."""
        now_s = time.monotonic()
        for handle, late_s in list(self.leaving.items()):
            if handle.ended() is not None:
                handle.bury()
                del self.leaving[handle]
            elif now_s >= late_s:
                handle.kill()
                if now_s > late_s + KILLED_S:
                    log.error("%s: process %d hangs in the kernel", handle.name, handle.pid)
                    self.leaving[handle] = float("inf")  # it is buried when it ends after all

    def _spawn(self, modules: Collection[str], *, wanted: bool) -> NodeProcess:
        folder = self.run_folder
        return spawn(folder.run_id, folder.folder.path, modules, wanted=wanted, reaper=self.reaper)

    def let_go(self, managed: ManagedProcess) -> None:
        """Let a process that is ready begin, if it may."""
        if managed.handle is not None and self._is_heard(managed) and self._may_go(managed):
            managed.handle.going, managed.going_since_s = True, time.monotonic()
            managed.handle.tell(Go())
            if managed.sources and not self.exposing_since_s:
                self.exposing_since_s = managed.going_since_s
            if self.ending:
                managed.handle.tell(Finish())

    def is_first(self, managed: ManagedProcess) -> bool:
        """Whether its process is the first of the run."""
        return managed.epoch == self._first_epoch + 1

    def is_unborn(self, managed: ManagedProcess) -> bool:
        """Whether its process is the first of the run and has not opened its operators yet."""
        return self.is_first(managed) and not (managed.handle and managed.handle.ready)

    @property
    def sources_wait(self) -> bool:
        """Whether there are sources here, and none of them has begun."""
        return bool(self.source_names) and not self.exposing_since_s

    def _is_heard(self, managed: ManagedProcess) -> bool:
        """Sources begin when every reader has heard them; the others at once."""
        if not managed.sources:
            return True
        all_ready = all(s.handle and s.handle.ready for s in self.processes.values())
        if self.is_first(managed) and not all_ready:
            return False
        first = self.is_first(managed)
        mine = [e for e in self.plan.edges if first or e.source in managed.sources]
        accounts = [self.ledger.edges[e.index] for e in mine]
        return all(account.live or not account.reader_epoch for account in accounts)

    def note(self) -> None:
        """Write down what others may want to know about this run."""
        self.run_folder.note(
            {
                "graph": self.plan.name,
                "clock": self.plan.clock,
                "nodes": [
                    {
                        "name": n.name,
                        "index": n.index,
                        "process": n.process,
                        "operator": n.operator,
                    }
                    for n in filter(self.plan.is_here, self.plan.nodes)
                ],
                "edges": [
                    {"from": e.origin, "to": e.end, "index": e.index}
                    for e in self.plan.edges
                    if self.plan.touches(e)
                ],
                "plan": adapter(Plan).dump_python(self.plan, mode="json"),
                "revision": self.revision,
                "pids": {s.name: s.handle.pid for s in self.processes.values() if s.handle},
                "restarts": self.restarts,
                "crashes": self.crashes,
            }
        )
