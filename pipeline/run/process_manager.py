"""Start and end the processes of a running graph, and keep their accounts.

Supervision, swaps and topology changes build on it.
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
    """Let every ready process begin."""
    return True


class ProcessManager:
    """The processes of one plan, with their run folder."""

    def __init__(
        self, plan: Plan, *, frames: int = 0, folder: str = "", first_epoch: int = 0,
        may_go: MayGo = always, reaper: Reaper | None = None,
        ports: Mapping[str, Ports] | None = None,
    ) -> None:  # fmt: skip
        """`folder`: name of the run folder, default the graph's; epochs start after `first_epoch`.

        `may_go`: additional condition for a ready process to begin. `reaper`: of this process, if
        it may adopt orphans of nodes. `ports`: of the plan's operators, by `module:Class`;
        without them the operators are imported.
        """
        self._may_go, self.reaper = may_go, reaper
        self.plan, self._frames, self._first_epoch = plan, frames, first_epoch
        self.networks: dict[str, Network] = {}  # by process, for those with edges to other hosts
        names = [name for n in plan.nodes for name in (n.name, n.process)]
        check_addresses(folder_of(folder or plan.name), names)
        if ports is None:  # the loader has imported the operators
            here = filter(plan.is_here, plan.nodes)
            ports = {node.operator: declared_ports(node.operator) for node in here}
        self._ports = dict(ports)
        self.run_folder = RunFolder.claim(folder or plan.name)
        try:
            self.ledger = Ledger.create(self.run_folder.memory, len(plan.edges), len(plan.nodes))
            self.exchange = Exchange()
        except BaseException:
            self.run_folder.release()
            raise
        self.handles: list[ProcessHandle] = []  # started, and not yet cleaned up
        self.leaving: dict[
            ProcessHandle, float
        ] = {}  # deadline (monotonic) after which an ending process is killed
        self.asked_to_end: Callable[[], int] = lambda: 0  # several requests mean haste
        self.stop_orders = 0  # number of requests by clients
        self.spare = WarmSpare(partial(self._spawn, wanted=False))
        self.processes = {
            name: ManagedProcess(name, nodes, epoch=first_epoch, sources=self._sources_of(nodes))
            for name, nodes in plan.processes().items()
        }
        self.revision = 0  # of the plan
        self.exposing_since_s = 0.0  # monotonic time when the first source began
        self.failure = ""
        self.ending = False  # sources are to stop producing
        self.finished_sources: set[str] = set()
        self.restarts: dict[str, int] = {}  # by process
        self.crashes: dict[str, int] = {}  # unexpected ends, by process

    @property
    def end_requests(self) -> int:
        """The number of requests to end the run."""
        return self.asked_to_end() + self.stop_orders

    @property
    def all_going(self) -> bool:
        """Whether every process is running."""
        return all(managed.handle and managed.handle.going for managed in self.processes.values())

    @property
    def finished(self) -> bool:
        """Whether every source has produced its last frame, or the run has failed."""
        wanted = self.source_names
        return bool(self.failure) or (bool(wanted) and wanted <= self.finished_sources)

    @property
    def source_names(self) -> frozenset[str]:
        """The sources on this host."""
        return frozenset().union(*(managed.sources for managed in self.processes.values()))

    def begin_all(self) -> None:
        """Start every process; the caller continues with `tick`."""
        for managed in reversed(self.processes.values()):
            if not self.end_requests:
                self.begin(managed)
        self.note()

    def begin(
        self, managed: ManagedProcess, *, plan: Plan | None = None, checked: bool = False
    ) -> None:
        """Start the next instance of a process; `checked`: verify its ports first."""
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
        """Return the assignment of a process; `checked`: with the contracts of running edges."""
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
        """Return the ports of a node's operator; raises `RunError` if no process reported them."""
        try:
            return self._ports[node.operator]
        except KeyError:
            raise RunError(f"{node.name}: no process has imported {node.operator}") from None

    def learn(self, handle: ProcessHandle, imported: Imported) -> None:
        """Store what a process has imported: ports of its operators, files of its code."""
        for operator in handle.operators & imported.ports.keys():
            self._ports[operator] = imported.ports[operator]
        self.spare.watch(imported.files)

    def _sources_of(self, nodes: Iterable[Node]) -> frozenset[str]:
        return frozenset(node.name for node in nodes if self.ports_of(node).source)

    def accounts(self, managed: ManagedProcess, *, outgoing: bool = False) -> list[EdgeAccount]:
        """Return the accounts of the edges into a process, or out of it."""
        names = {node.name for node in managed.nodes}
        return [
            self.ledger.edges[edge.index]
            for edge in self.plan.edges
            if (edge.source if outgoing else edge.target) in names
        ]

    def release(self) -> None:
        """Release the run folder and its memory; every process must have ended."""
        self.run_folder.release()

    def vacate(self, managed: ManagedProcess) -> None:
        """Mark a process as absent, so that writers do not wait for it."""
        if managed.handle is not None:
            self.dismiss(managed.handle)
        managed.handle = None
        for account in self.accounts(managed):
            account.reader_epoch = account.receiver_epoch = account.next_receiver_epoch = 0
        for node in managed.nodes:
            self.ledger.nodes[node.index].enter("absent")

    def live_file(self, node: str) -> Path:
        """Return the file of a node's changed live settings."""
        return self.run_folder.folder.path / f"{node}.live"

    def change_plan(self, plan: Plan) -> None:
        """Switch to another plan; removed processes must have ended."""
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
        """Return a process for an assignment; `fresh`: with the current code on disk.

        Raises `RunError` when no process can be started.
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
        """Give a process that time to end, then kill it, without waiting."""
        self.leaving[handle] = time.monotonic() + within_s
        self.see_off()

    def see_off(self) -> None:
        """Kill dismissed processes after their deadline, and clean up ended ones."""
        now_s = time.monotonic()
        for handle, late_s in list(self.leaving.items()):
            if handle.ended() is not None:
                handle.bury()
                del self.leaving[handle]
            elif now_s >= late_s:
                handle.kill()
                if now_s > late_s + KILLED_S:
                    log.error("%s: process %d hangs in the kernel", handle.name, handle.pid)
                    self.leaving[handle] = float("inf")  # it is cleaned up when it ends

    def _spawn(self, modules: Collection[str], *, wanted: bool) -> NodeProcess:
        folder = self.run_folder
        return spawn(folder.run_id, folder.folder.path, modules, wanted=wanted, reaper=self.reaper)

    def let_go(self, managed: ManagedProcess) -> None:
        """Let a ready process begin, if its conditions are met."""
        if managed.handle is not None and self._is_heard(managed) and self._may_go(managed):
            managed.handle.going, managed.going_since_s = True, time.monotonic()
            managed.handle.tell(Go())
            if managed.sources and not self.exposing_since_s:
                self.exposing_since_s = managed.going_since_s
            if self.ending:
                managed.handle.tell(Finish())

    def is_first(self, managed: ManagedProcess) -> bool:
        """Whether its process is its first instance in the run."""
        return managed.epoch == self._first_epoch + 1

    def is_unborn(self, managed: ManagedProcess) -> bool:
        """Whether its process is its first instance and has not opened its operators yet."""
        return self.is_first(managed) and not (managed.handle and managed.handle.ready)

    @property
    def sources_wait(self) -> bool:
        """Whether there are sources here and none has begun."""
        return bool(self.source_names) and not self.exposing_since_s

    def _is_heard(self, managed: ManagedProcess) -> bool:
        """Whether all readers of its sources have their handshake; True without sources."""
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
        """Write the facts of this run for other processes."""
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
                "gone": [
                    s.name
                    for s in self.processes.values()
                    if s.deaths and not (s.handle or s.next_start_s)
                ],
                "restarts": self.restarts,
                "crashes": self.crashes,
            }
        )
