"""Supervise a graph: start its processes, monitor progress, restart, stop, account.

It is composed of a process manager, a health monitor and a control server.

Only this process writes which instance of a node is active (`reader_epoch`, `writer_epoch`).
"""

import logging
import signal
import threading
import time
from collections.abc import Callable, Mapping

from pipeline.bus.ledger import Ledger
from pipeline.bus.session import Session
from pipeline.errors import RunError
from pipeline.graph.plan import Plan
from pipeline.graph.ports import Ports
from pipeline.node.group import FAREWELL_S
from pipeline.protocol.orders import GRAPH
from pipeline.protocol.supervision import (
    Event,
    Failed,
    Finish,
    Finished,
    Fits,
    Ready,
    Stop,
)
from pipeline.run.control_server import ControlServer
from pipeline.run.descendants import end_tagged
from pipeline.run.health import HealthMonitor, late
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.node_reports import NodeReports
from pipeline.run.process_handle import KILLED_S, ProcessHandle, Sample, ending
from pipeline.run.process_manager import MayGo, ProcessManager, always
from pipeline.run.reaper import Reaper
from pipeline.run.restarts import Restarts
from pipeline.text import harmless

TICK_S = 0.02
SAMPLE_S = 1.0
DRAIN_S = 5.0  # limit without any message being accounted for
LONGEST_DRAIN_S = 60.0
HANGS_S = 10.0  # a process that has not ended this long after it was killed
STOP_S = FAREWELL_S + 3.0  # in which it also writes what hangs, on a busy machine
KILLED, TOO_LATE = -signal.SIGKILL, 2  # status of a node that does not stop: killed, or timed out
CLOSE_S = 3.0  # for leaving the bus: a frozen client may delay it
log = logging.getLogger(__name__)


class Supervisor:
    """Runs a plan in the foreground. Use it as a context: leaving it stops and removes all."""

    def __init__(
        self, plan: Plan, *, frames: int = 0, folder: str = "", first_epoch: int = 0,
        may_go: MayGo = always, reaper: Reaper | None = None,
        ports: Mapping[str, Ports] | None = None,
    ) -> None:  # fmt: skip
        """Parameters as for `ProcessManager`; orders are accepted from now on."""
        self.manager = ProcessManager(
            plan, frames=frames, folder=folder, first_epoch=first_epoch, may_go=may_go,
            reaper=reaper, ports=ports,
        )  # fmt: skip
        self.health = HealthMonitor(self.manager.ledger)
        try:
            self._hub = Session(self.manager.run_folder.folder.path, "hub")
        except BaseException:
            self.manager.exchange.close()
            self.manager.release()
            raise
        self.control = ControlServer(self.manager, self.health)
        self._hub.answer(f"fovea/{plan.name}/{GRAPH}", self.control.ask)
        self.reports, self._restarts = NodeReports(), Restarts(self.manager)
        self._sampled_s = 0.0
        self.started_s = time.monotonic()
        self.begun = False  # whether every process has been running once

    @property
    def plan(self) -> Plan:
        """The current plan."""
        return self.manager.plan

    @property
    def ledger(self) -> Ledger:
        """The accounts of nodes and edges."""
        return self.manager.ledger

    @property
    def revision(self) -> int:
        """The number of changes of the plan."""
        return self.manager.revision

    @property
    def processes(self) -> dict[str, ManagedProcess]:
        """The processes of the plan by name."""
        return self.manager.processes

    @property
    def finished(self) -> bool:
        """Whether every source has produced its last frame, or the run has failed."""
        return self.manager.finished

    @property
    def failure(self) -> str:
        """Why the run cannot continue; empty while it can."""
        return self.manager.failure

    @property
    def restarts(self) -> dict[str, int]:
        """The number of restarts, by process."""
        return self.manager.restarts

    @property
    def crashes(self) -> dict[str, int]:
        """The number of unexpected ends, by process, restarted or not."""
        return self.manager.crashes

    @property
    def exposed_s(self) -> float:
        """Return the time since the first exposure, in seconds; 0 if the run never began."""
        since_s = self.manager.exposing_since_s or (self.started_s if self.begun else 0.0)
        return time.monotonic() - since_s if since_s else 0.0

    def allow_restarts(self, count: int) -> None:
        """Allow at least this many restarts, whatever the graph sets; for tests that kill nodes."""
        self._restarts.at_least = count

    @property
    def asked_to_end(self) -> Callable[[], int]:
        """A function for the number of requests to end the run, e.g. signals."""
        return self.manager.asked_to_end

    @asked_to_end.setter
    def asked_to_end(self, asked: Callable[[], int]) -> None:
        self.manager.asked_to_end = asked

    @property
    def end_requests(self) -> int:
        """The number of requests to end the run, by signals and clients."""
        return self.manager.end_requests

    def pid(self, process: str) -> int:
        """Return the current pid of a process; 0 while there is none."""
        handle = self.processes[process].handle
        return handle.pid if handle else 0

    def load_s(self, process: str) -> float:
        """Return the time in seconds to open the current process's operators; 0 until ready."""
        handle = self.processes[process].handle
        return handle.load_s if handle else 0.0

    def samples(self, process: str) -> list[Sample]:
        """Return a process's samples, about one per second: the first and the last minutes."""
        return list(self.processes[process].samples)

    def __enter__(self) -> "Supervisor":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Start every process, consumers first; frames flow once all are ready.

        `meanwhile` is called at every tick. Returns early on a request to end; raises `RunError`
        when the run cannot begin.
        """
        self.manager.begin_all()
        deadline = time.monotonic() + max(node.start_s for node in self.plan.nodes)
        while not self.manager.all_going and not self.end_requests:
            self.tick()
            meanwhile()
            if self.failure:
                raise RunError(self.failure)
            for managed in self.processes.values():
                if why := late(managed):
                    to_read = self.manager.run_folder.to_read(managed.name)
                    raise RunError(f"{managed.name}: {why}, see {to_read}")
            if time.monotonic() > deadline:
                raise RunError("the readers of a source did not receive its handshake in time")
        self.begun = self.manager.all_going
        self.started_s = time.monotonic()

    def tick(self) -> None:
        """Check everything once, then wait for a moment or an event."""
        self.health.tick()
        self._hear()
        self.manager.see_off()
        self.control.tick()
        now_s = time.monotonic()
        for managed in self.processes.values():
            self._look_after(managed, now_s)
        if now_s - self._sampled_s >= SAMPLE_S:
            self._sampled_s = now_s
            self._sample()
        self._keep_a_spare()
        self.manager.exchange.wait(TICK_S)

    def finish(self) -> None:
        """Let the sources end and messages in flight arrive, while there is progress.

        After a request to end, wait for at most `DRAIN_S`; after several, do not wait.
        """
        self.manager.ending = True
        for managed in self.processes.values():
            if managed.sources and managed.handle and managed.handle.going:
                managed.handle.tell(Finish())
        began_s = moved_s = now_s = time.monotonic()
        ends = self.ledger.ends()
        while now_s - moved_s < DRAIN_S and now_s - began_s < LONGEST_DRAIN_S:
            if self.finished and self._drained():
                self._write_off()
                return
            if self.end_requests and (self.in_haste or now_s - began_s > DRAIN_S):
                return
            self.tick()
            now_s = time.monotonic()
            if (ends_now := self.ledger.ends()) != ends:
                ends, moved_s = ends_now, now_s

    def _drained(self) -> bool:
        """Whether no message is in flight, except to nodes that will not restart."""
        nobody = self._to_nobody()
        pairs = zip(self.ledger.edges, self.ledger.ends(), strict=True)
        return all(edge.sent == end or i in nobody for i, (edge, end) in enumerate(pairs))

    def _to_nobody(self) -> set[int]:
        """Return the indices of edges into ended processes that will not restart."""
        gone = [
            s for s in self.processes.values() if not s.handle and (s.sources or not s.next_start_s)
        ]
        names = {node.name for managed in gone for node in managed.nodes}
        return {edge.index for edge in self.plan.edges if edge.target in names}

    def _write_off(self) -> None:
        """Count messages in flight to ended processes as lost."""
        for index in self._to_nobody():
            account = self.ledger.edges[index]
            account.lost_in_crash += account.in_flight

    @property
    def in_haste(self) -> bool:
        """Whether there were several requests to end, so that nothing is waited for."""
        return self.end_requests > 1

    def stop(self) -> None:
        """Stop every process and its descendants, and collect their last events."""
        self.manager.ending = True
        self._sample()
        self.manager.spare.dismiss()
        handles = {managed.handle for managed in self.processes.values() if managed.handle}
        handles |= {*self.control.abort(), *self.manager.leaving}
        for handle in handles:
            handle.tell(Stop())
        self._await_ends(handles, STOP_S)
        for handle in handles:
            if handle.ended() is None and not self.in_haste:
                log.warning("%s: did not stop; killed", handle.name)
            handle.kill()
        self._await_ends(handles, KILLED_S, hurries=False)
        for handle in handles:
            handle.bury(outside=False)
        if self.manager.handles:
            end_tagged(self.manager.run_folder.run_id)
            self._end_orphans()
        self._hear()
        for handle in handles:
            status = handle.ended()
            if status == TOO_LATE and not (handle.left or self.in_haste):
                what = "close; its device may still be open" if handle.ready else "finish opening"
                log.warning(
                    "%s: did not end within %g s: it did not %s, see %s", handle.name, FAREWELL_S,
                    what, self.manager.run_folder.to_read(handle.name),
                )  # fmt: skip
            if status in (None, KILLED, TOO_LATE) or (status == 0 and handle.left):
                continue
            self._restarts.count_crash(handle.name)
            if not handle.left:
                log.warning("%s: ended by %s while it was stopped", handle.name, ending(status))
        for managed in self.processes.values():
            managed.handle = None
        self.manager.leaving.clear()

    def close(self) -> None:
        """Clean up all processes, sockets and memory."""
        try:
            self.stop()
        finally:
            try:
                self.manager.exchange.close()
                leave = threading.Thread(target=self._hub.close, name="leave-bus", daemon=True)
                leave.start()
                leave.join(CLOSE_S)
            finally:
                self.manager.release()

    def _await_ends(
        self, handles: set[ProcessHandle], limit_s: float, *, hurries: bool = True
    ) -> None:
        """Wait until all have ended while reading their events; do not wait in haste."""
        late_s = time.monotonic() + limit_s
        while any(handle.ended() is None for handle in handles) and time.monotonic() < late_s:
            if hurries and self.in_haste:
                return
            self.manager.exchange.wait(TICK_S)
            self._hear()

    def _keep_a_spare(self) -> None:
        if self.plan.clock == "realtime" and self.manager.all_going:
            here = filter(self.plan.is_here, self.plan.nodes)
            self.manager.spare.keep({node.operator.partition(":")[0] for node in here})

    def _hear(self) -> None:
        for handle in list(self.manager.handles):
            for event in handle.events():
                self._take_note(handle, event)
            if handle.gone:
                self.manager.handles.remove(handle)

    def _take_note(self, handle: ProcessHandle, event: Event) -> None:
        managed = self.processes.get(handle.name)
        if isinstance(event, Fits | Ready):
            self.manager.learn(handle, event.imported)
        if self.control.on_event(handle.pid, event):
            return
        present = managed is not None and managed.handle is handle
        self.reports.note(handle, event, present=present)
        if managed is None or not present:
            return  # from a removed node or a replaced process
        if isinstance(event, Ready):
            handle.ready, handle.load_s = True, event.load_s
        elif isinstance(event, Finished) and event.node in handle.nodes:
            self.manager.finished_sources.add(event.node)
        elif isinstance(event, Failed):
            self._note_failure(managed, event)

    def _note_failure(self, managed: ManagedProcess, event: Failed) -> None:
        """End the run if a restart cannot help: the graph never began, or a source failed."""
        unborn = self.manager.is_unborn(managed)
        error = harmless(event.error)
        if event.expected and (unborn or managed.sources) and not self.failure:
            self.manager.failure = error
        elif not self.failure:
            managed.last_words = error
            log.error("%s: %s", managed.name, managed.last_words)

    def _look_after(self, managed: ManagedProcess, now_s: float) -> None:
        if self.control.owns(managed):
            return
        if managed.handle is None and managed.sources and self.manager.ending:
            # a source that has ended need not restart
            self.manager.finished_sources |= managed.sources
        elif managed.handle is None:
            if managed.next_start_s and now_s >= managed.next_start_s:
                self._restarts.begin_again(managed, now_s)
        elif (status := managed.handle.ended()) is not None:
            managed.handle.bury()
            self._hear()  # read its last events before its exit is handled
            self._restarts.on_end(managed, status, now_s)
        elif managed.handle.ready and not managed.handle.going:
            self.manager.let_go(managed)
        elif managed.handle.killed_s:
            if 0 < managed.handle.killed_s < now_s - HANGS_S:
                log.error("%s: process %d hangs in the kernel", managed.name, managed.handle.pid)
                managed.handle.killed_s = float("inf")  # it is told once
        elif why := self.health.problem(managed):
            log.error("%s: %s; killed", managed.name, why)
            managed.last_words = why
            managed.handle.kill(with_traceback=True)

    def _sample(self) -> None:
        for managed in self.processes.values():
            sample = managed.handle.sample() if managed.handle else None
            if sample:
                managed.samples.append(sample)
        self._end_orphans()

    def _end_orphans(self) -> None:
        if self.manager.reaper is not None:
            self.manager.reaper.end()
