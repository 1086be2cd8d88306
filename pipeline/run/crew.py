"""The processes of a running graph: slots, their accounts, and how they are started.

What supervises them, and what changes them while they run, stand on this.
"""

import logging
import time
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path

from pipeline.bus.ledger import EdgeAccount, Ledger
from pipeline.bus.network import Network
from pipeline.errors import RunError
from pipeline.graph.plan import Plan, is_source
from pipeline.node.place import place_of
from pipeline.node.wiring import Assignment
from pipeline.once import adapter
from pipeline.run.channel import Exchange
from pipeline.run.child import KILLED_S, Child, NodeProcess, Sample, spawn
from pipeline.run.judge import Judge
from pipeline.run.run_folder import RunFolder
from pipeline.run.rundir import check_addresses, folder_of
from pipeline.run.slot import Slot
from pipeline.run.spare import Spare

log = logging.getLogger(__name__)


class Crew:
    """The slots of one plan, in a run folder of their own."""

    def __init__(
        self, plan: Plan, *, frames: int = 0, folder: str = "", first_epoch: int = 0
    ) -> None:
        """`folder`: where it runs, else the graph's name; epochs begin after the first one."""
        self.plan, self._frames, self._first_epoch = plan, frames, first_epoch
        self.networks: dict[str, Network] = {}  # by process, of those that reach other hosts
        names = [name for n in plan.nodes for name in (n.name, n.process)]
        check_addresses(folder_of(folder or plan.name), names)
        self._run = RunFolder.claim(folder or plan.name)
        try:
            self.ledger = Ledger.create(self._run.memory, len(plan.edges), len(plan.nodes))
            self.exchange = Exchange()
        except BaseException:
            self._run.release()
            raise
        self.children: list[Child] = []  # that were started, until all they said was heard
        self._leaving: dict[Child, float] = {}  # when those are killed that shall end, monotonic
        self.asked_to_end: Callable[[], int] = lambda: 0  # how often: more than once is in haste
        self.spare = Spare(partial(self._spawn, wanted=False))
        self._judge = Judge()
        self.slots = {
            name: Slot(
                name,
                nodes,
                epoch=first_epoch,
                sources=frozenset(n.name for n in nodes if is_source(n)),
            )
            for name, nodes in plan.processes().items()
        }
        self.revision = 0  # of the plan
        self.failure = ""
        self.ending = False  # sources shall make no more frames
        self._finished: set[str] = set()

    @property
    def all_going(self) -> bool:
        """Every process works."""
        return all(slot.child and slot.child.going for slot in self.slots.values())

    @property
    def finished(self) -> bool:
        """Every source has made its last frame, or the run has failed."""
        wanted = set().union(*(slot.sources for slot in self.slots.values()))
        return bool(self.failure) or (bool(wanted) and wanted <= self._finished)

    def begin_all(self) -> None:
        """Start every process; the caller goes on with `tick`."""
        for slot in reversed(self.slots.values()):
            if not self.asked_to_end():
                self.begin(slot)
        self.note()

    def begin(self, slot: Slot, *, plan: Plan | None = None, checked: bool = False) -> None:
        """Start a process as its next incarnation; `checked`: of a plan that is still to prove."""
        slot.epoch = slot.promise()
        for node in slot.nodes:
            self.ledger.nodes[node.index].enter("starting")
        for account in self.accounts(slot, outgoing=True):
            account.writer_epoch = slot.epoch
        for account in self.accounts(slot):
            account.reader_epoch = account.door = slot.epoch
            account.next_door = 0
        job = self.job(slot, plan or self.plan, slot.epoch, checked=checked)
        slot.child = self.launch(job, fresh=checked)

    def job(
        self,
        slot: Slot,
        plan: Plan,
        epoch: int,
        *,
        standby: bool = False,
        checked: bool = False,
        trial: bool = False,
    ) -> Assignment:
        """What a process of that slot has to do; `checked`: it must fit the edges that run now."""
        mine = self.plan.processes()[slot.name]
        return Assignment(
            plan=plan,
            process=slot.name,
            run_folder=str(self._run.folder.path),
            memory_folder=str(self._run.memory.path),
            epochs={node.name: epoch for node in mine},
            frames=self._frames,
            network=self.networks.get(slot.name),
            standby=standby or trial,
            trial=trial,
            places={n.name: place_of(self.plan, n) for n in mine} if checked or trial else {},
        )

    def accounts(self, slot: Slot, *, outgoing: bool = False) -> list[EdgeAccount]:
        """Of the edges into a process, or out of it."""
        names = {node.name for node in slot.nodes}
        return [
            self.ledger.edges[edge.index]
            for edge in self.plan.edges
            if (edge.source if outgoing else edge.target) in names
        ]

    def vacate(self, slot: Slot) -> None:
        """Nobody works there now: writers do not wait for it."""
        if slot.child is not None:
            self.dismiss(slot.child)
        slot.child = None
        for account in self.accounts(slot):
            account.reader_epoch = account.door = account.next_door = 0
        for node in slot.nodes:
            self.ledger.nodes[node.index].enter("absent")

    def live_file(self, node: str) -> Path:
        """Where a node keeps the settings that it was told while it ran."""
        return self._run.folder.path / f"{node}.live"

    def change_plan(self, plan: Plan) -> None:
        """Another plan runs now; a process that left it must have ended."""
        self.plan, self.revision = plan, self.revision + 1
        for name, nodes in plan.processes().items():
            slot = self.slots.setdefault(name, Slot(name, nodes))
            slot.nodes = nodes
            slot.sources = frozenset(n.name for n in nodes if is_source(n))
        for name in self.slots.keys() - plan.processes().keys():
            if self.slots[name].child is None:
                del self.slots[name]
        self.note()

    def launch(self, job: Assignment, *, fresh: bool = False) -> Child:
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
        child = Child(process, job, self.exchange)
        self.children.append(child)
        return child

    def dismiss(self, child: Child, within_s: float = 0.0) -> None:
        """Let a process end by itself in that time, or be killed; nobody waits for it."""
        self._leaving[child] = time.monotonic() + within_s
        self._see_off()

    def _see_off(self) -> None:
        """Kill those that were to end by now, give back what is left of those that have."""
        now_s = time.monotonic()
        for child, late_s in list(self._leaving.items()):
            if child.ended() is not None:
                child.bury()
                del self._leaving[child]
            elif now_s >= late_s:
                child.kill()
                if now_s > late_s + KILLED_S:
                    log.error("%s: process %d hangs in the kernel", child.name, child.pid)
                    self._leaving[child] = float("inf")  # it is buried when it ends after all

    def _spawn(self, modules: Collection[str], *, wanted: bool) -> NodeProcess:
        return spawn(self._run.run_id, self._run.folder.path, modules, wanted=wanted)

    def let_go(self, slot: Slot) -> None:
        """Let a process that is ready begin, if it may."""
        if slot.child is not None and self._may_go(slot):
            slot.child.going, slot.going_since_s = True, time.monotonic()
            slot.child.tell("go")
            if self.ending:
                slot.child.tell("finish")

    def _is_first(self, slot: Slot) -> bool:
        return slot.epoch == self._first_epoch + 1

    def _may_go(self, slot: Slot) -> bool:
        """Sources begin when every reader has heard them; the others at once."""
        if not slot.sources:
            return True
        all_ready = all(s.child and s.child.ready for s in self.slots.values())
        if self._is_first(slot) and not all_ready:
            return False
        first = self._is_first(slot)
        mine = [e for e in self.plan.edges if first or e.source in slot.sources]
        accounts = [self.ledger.edges[e.index] for e in mine]
        return all(account.live or not account.reader_epoch for account in accounts)

    def stalled(self, slot: Slot) -> str:
        """Why its process has to be killed, or nothing."""
        return self._judge.complaint(slot, self.ledger)

    def samples(self, process: str) -> list[Sample]:
        """What a process used, about once a second: the first minutes and the last."""
        return list(self.slots[process].samples)

    def load_s(self, process: str) -> float:
        """How long the present process took to open its operators, 0 until it is ready."""
        child = self.slots[process].child
        return child.load_s if child else 0.0

    def pid(self, process: str) -> int:
        """Its present process id, 0 while there is none."""
        child = self.slots[process].child
        return child.pid if child else 0

    def note(self) -> None:
        self._run.note(
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
                "pids": {s.name: s.child.pid for s in self.slots.values() if s.child},
            }
        )
