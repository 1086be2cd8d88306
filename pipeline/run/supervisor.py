"""Keeps a graph running: starts its processes, watches progress, restarts, stops, accounts.

Only this process writes who reads and who speaks for a node now (`reader_epoch`, `writer_epoch`).
"""

import logging
import queue
import subprocess
import time
from collections.abc import Collection
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from pipeline.bus.ledger import EdgeAccount, Ledger
from pipeline.bus.network import Network
from pipeline.bus.session import Session
from pipeline.errors import RunError
from pipeline.graph.plan import Plan, is_source
from pipeline.node.place import place_of
from pipeline.node.wiring import Assignment
from pipeline.run.child import Child, Events, Sample, ending, spawn
from pipeline.run.desk import COMMAND, Desk
from pipeline.run.judge import Judge, late
from pipeline.run.rundir import MEMORY, RunFolder
from pipeline.run.slot import Slot
from pipeline.run.spare import Spare

TICK_S = 0.02
SAMPLE_S = 1.0
HEALTHY_S = 1.0  # who ran this long starts with the shortest back-off again
DRAIN_S = 5.0
STOP_S = 4.0
log = logging.getLogger(__name__)


class Supervisor:
    """Runs a plan in the foreground. Use it as a context: leaving it stops and removes all."""

    def __init__(
        self, plan: Plan, *, frames: int = 0, folder: str = "", first_epoch: int = 0
    ) -> None:
        """`folder`: where it runs, else the graph's name; epochs begin after the first one."""
        self.plan, self._frames, self._first_epoch = plan, frames, first_epoch
        self.networks: dict[str, Network] = {}  # by process, of those that reach other hosts
        self._run = RunFolder.claim(folder or plan.name)
        self.ledger = Ledger.create(
            MEMORY / f"{self._run.prefix}ledger",
            len(plan.edges),
            len(plan.nodes),
        )
        self._hub = Session(self._run.folder, "hub")
        self._events: Events = queue.SimpleQueue()
        self._spare = Spare(self._spawn)
        self._judge = Judge()
        self.desk = Desk(self)
        self._hub.answer(f"fovea/{plan.name}/{COMMAND}", self.desk.ask)
        self.slots = {
            name: Slot(
                name,
                nodes,
                epoch=first_epoch,
                sources=frozenset(n.name for n in nodes if is_source(n)),
            )
            for name, nodes in plan.processes().items()
        }
        self.summaries: dict[str, dict[str, Any]] = {}
        self.headlines: dict[str, str] = {}  # what nodes have to tell while they run
        self.restarts: dict[str, int] = {}
        self.revision = 0  # of the plan
        self._finished: set[str] = set()
        self._sampled_s = 0.0
        self.started_s = time.monotonic()
        self.failure = ""
        self.patience = 0  # deaths allowed whatever the graph says; for those who kill on purpose

    def __enter__(self) -> "Supervisor":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Start every process, consumers first; frames flow once all are ready."""
        self.begin_all()
        deadline = time.monotonic() + max(node.start_s for node in self.plan.nodes)
        while not self.all_going:
            self.tick()
            if self.failure:
                raise RunError(self.failure)
            for slot in self.slots.values():
                if why := late(slot):
                    raise RunError(f"{slot.name}: {why}, see `fovea logs {slot.name}`")
            if time.monotonic() > deadline:
                raise RunError("the readers of a source have not heard it in all that time")
        self.started_s = time.monotonic()

    def begin_all(self) -> None:
        """Start every process; the caller goes on with `tick`."""
        for slot in reversed(self.slots.values()):
            self.begin(slot)
        self.note()

    def tick(self) -> None:
        """Look after everything once, then rest for a moment."""
        self._hear()
        self.desk.attend()
        self._judge.look()
        now_s = time.monotonic()
        for slot in self.slots.values():
            self._look_after(slot, now_s)
        if now_s - self._sampled_s >= SAMPLE_S:
            self._sampled_s = now_s
            self._sample()
        self._keep_a_spare()
        time.sleep(TICK_S)

    @property
    def finished(self) -> bool:
        """Every source has made its last frame, or the run has failed."""
        wanted = set().union(*(slot.sources for slot in self.slots.values()))
        return bool(self.failure) or (bool(wanted) and wanted <= self._finished)

    def finish(self) -> None:
        """Let the sources end and what is under way arrive; bounded in time."""
        for slot in self.slots.values():
            if slot.sources and slot.child:
                slot.child.tell("finish")
        deadline = time.monotonic() + DRAIN_S
        while time.monotonic() < deadline and not (self.finished and self.ledger.drained()):
            self.tick()

    def stop(self) -> None:
        """Stop every process, collect what they have to say."""
        self._sample()
        self._spare.dismiss()
        children = [slot.child for slot in self.slots.values() if slot.child]
        children += self.desk.give_up()
        for child in children:
            child.tell("stop")
        deadline = time.monotonic() + STOP_S
        for child in children:
            child.reap(max(0.1, deadline - time.monotonic()))
        for slot in self.slots.values():
            slot.child = None
        self._hear()

    def close(self) -> None:
        """Nothing is left behind: no process, no socket, no memory."""
        self.stop()
        self._hub.close()
        self._run.release()

    def samples(self, process: str) -> list[Sample]:
        """What a process used, about once a second, the last two hours."""
        return list(self.slots[process].samples)

    def load_s(self, process: str) -> float:
        """How long the present process took to open its operators, 0 until it is ready."""
        child = self.slots[process].child
        return child.load_s if child else 0.0

    def pid(self, process: str) -> int:
        """Its present process id, 0 while there is none."""
        child = self.slots[process].child
        return child.pid if child else 0

    @property
    def all_going(self) -> bool:
        """Every process works."""
        return all(slot.child and slot.child.going for slot in self.slots.values())

    def begin(self, slot: Slot, *, plan: Plan | None = None, checked: bool = False) -> None:
        """Start a process as its next incarnation; `checked`: of a plan that is still to prove."""
        slot.epoch += 1
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
        mine = [n for n in self.plan.nodes if n.process == slot.name]
        return Assignment(
            plan=plan,
            process=slot.name,
            run_folder=str(self._run.folder),
            memory_folder=str(MEMORY),
            prefix=self._run.prefix,
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
        assert slot.child is not None
        slot.child.reap(0.1)
        slot.child = None
        for account in self.accounts(slot):
            account.reader_epoch = account.door = account.next_door = 0
        for node in slot.nodes:
            self.ledger.nodes[node.index].enter("absent")
            for stale in self._run.folder.glob(f"{node.name}.*.door"):
                stale.unlink(missing_ok=True)

    def live_file(self, node: str) -> Path:
        """Where a node keeps the settings that it was told while it ran."""
        return self._run.folder / f"{node}.live"

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
        """A process for an assignment; a `fresh` one has imported what is on disk now."""
        if fresh:
            self._spare.refresh()
        mine = {n.operator.partition(":")[0] for n in job.plan.nodes if n.process == job.process}
        popen = self._spare.take() or self._spawn(mine if fresh else ())
        return Child(popen, job, self._events)

    def _spawn(self, modules: Collection[str]) -> "subprocess.Popen[bytes]":
        return spawn(self._run.prefix, self._run.folder, modules)

    def _keep_a_spare(self) -> None:
        if self.plan.clock == "realtime" and self.all_going:
            here = filter(self.plan.is_here, self.plan.nodes)
            self._spare.keep({node.operator.partition(":")[0] for node in here})

    def _hear(self) -> None:
        while True:
            try:
                process, pid, event = self._events.get_nowait()
            except queue.Empty:
                return
            slot, kind = self.slots.get(process), event.get("event")
            if self.desk.hear(pid, event):
                continue
            if kind == "summary":
                self.summaries.setdefault(str(event["node"]), {}).update(event["figures"])
            elif slot is None:
                continue  # of a node that was removed
            elif kind == "ready" and slot.child and slot.child.pid == pid:
                slot.child.ready, slot.child.load_s = True, float(event.get("load_s", 0))
            elif kind == "finished":
                self._finished.add(str(event["node"]))
            elif kind == "headline":
                self.headlines[str(event["node"])] = str(event["words"])
            elif kind == "failed":
                self._note_failure(slot, event)

    def _note_failure(self, slot: Slot, event: dict[str, Any]) -> None:
        """What starting it again cannot mend ends the run: a graph that never began, a source."""
        unborn = self._is_first(slot) and not (slot.child and slot.child.ready)
        if event.get("expected") and (unborn or slot.sources) and not self.failure:
            self.failure = str(event["error"])
        elif not self.failure:
            slot.last_words = str(event.get("error"))
            log.error("%s: %s", slot.name, slot.last_words)

    def _look_after(self, slot: Slot, now_s: float) -> None:
        if self.desk.owns(slot):
            return
        if slot.child is None:
            if slot.next_start_s and now_s >= slot.next_start_s:
                slot.next_start_s = 0.0
                self.begin(slot)
                self.note()
            return
        status = slot.child.ended()
        if status is not None:
            self._bury(slot, status, now_s)
        elif slot.child.ready and not slot.child.going:
            self.let_go(slot)
        elif why := self.stalled(slot):
            log.error("%s: %s; killed", slot.name, why)
            slot.last_words = why
            slot.child.kill(with_traceback=True)

    def let_go(self, slot: Slot) -> None:
        """Let a process that is ready begin, if it may."""
        if slot.child is not None and self._may_go(slot):
            slot.child.going, slot.going_since_s = True, time.monotonic()
            slot.child.tell("go")

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

    def _bury(self, slot: Slot, status: int, now_s: float) -> None:
        self.vacate(slot)
        how = ending(status)
        if not self.failure:
            log.warning("%s ended by %s, see `fovea logs %s`", slot.name, how, slot.name)
        rule = slot.nodes[0].restart
        slot.deaths.append(now_s)
        lived = slot.going_since_s and now_s - slot.going_since_s > HEALTHY_S
        slot.quick_deaths = 0 if lived else slot.quick_deaths + 1
        slot.going_since_s = 0.0
        recent = sum(1 for death in slot.deaths if now_s - death < rule.window_s)
        if self.plan.clock == "lockstep":
            self.failure = f"{slot.name} ended by {how}: a lockstep run cannot go on"
        elif rule.policy == "never" or (rule.policy == "on-failure" and status == 0):
            self._finished |= slot.sources
        elif recent > max(rule.most, self.patience):
            last = f": {slot.last_words}" if slot.last_words else ""
            self.failure = f"{slot.name} died {recent} times within {rule.window_s:.0f} s{last}"
        else:
            slot.next_start_s = now_s + min(5.0, rule.backoff_s * 2 ** min(slot.quick_deaths, 8))
            self.restarts[slot.name] = self.restarts.get(slot.name, 0) + 1

    def stalled(self, slot: Slot) -> str:
        """Why its process has to be killed, or nothing."""
        return self._judge.complaint(slot, self.ledger)

    def _sample(self) -> None:
        for slot in self.slots.values():
            sample = slot.child.sample() if slot.child else None
            if sample:
                slot.samples.append(sample)

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
                "plan": TypeAdapter(Plan).dump_python(self.plan, mode="json"),
                "revision": self.revision,
                "pids": {s.name: s.child.pid for s in self.slots.values() if s.child},
            }
        )
