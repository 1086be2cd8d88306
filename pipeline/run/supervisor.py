"""Keeps a graph running: starts its processes, watches progress, restarts, stops, accounts.

Only this process writes who reads and who speaks for a node now (`reader_epoch`, `writer_epoch`).
"""

import logging
import threading
import time
from typing import Any

from pipeline.bus.session import Session
from pipeline.errors import RunError
from pipeline.graph.plan import Plan
from pipeline.protocol.orders import GRAPH
from pipeline.protocol.supervision import (
    Event,
    Failed,
    Finish,
    Finished,
    Headline,
    Ready,
    Stop,
    Summary,
)
from pipeline.run.control_server import ControlServer
from pipeline.run.descendants import end_tagged
from pipeline.run.health import late
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.process_handle import KILLED_S, ProcessHandle, ending
from pipeline.run.process_manager import ProcessManager
from pipeline.text import harmless, plain

TICK_S = 0.02
SAMPLE_S = 1.0
HEALTHY_S = 1.0  # who ran this long starts with the shortest back-off again
DRAIN_S = 5.0  # without a message that meets its end
LONGEST_DRAIN_S = 60.0
STOP_S = 4.0
CLOSE_S = 3.0  # for the bus to be left: a frozen visitor may hold it up
MOST_HEADLINE = 200  # characters
UNABLE_S = 2.0  # until a process that could not be started is tried again
log = logging.getLogger(__name__)


class Supervisor(ProcessManager):
    """Runs a plan in the foreground. Use it as a context: leaving it stops and removes all."""

    def __init__(
        self, plan: Plan, *, frames: int = 0, folder: str = "", first_epoch: int = 0
    ) -> None:
        """As for a `ProcessManager`; takes orders from now on."""
        super().__init__(plan, frames=frames, folder=folder, first_epoch=first_epoch)
        try:
            self._hub = Session(self._run.folder.path, "hub")
        except BaseException:
            self.exchange.close()
            self._run.release()
            raise
        self.control = ControlServer(self)
        self._hub.answer(f"fovea/{plan.name}/{GRAPH}", self.control.ask)
        self.summaries: dict[str, dict[str, Any]] = {}
        self.left_out: dict[str, str] = {}  # by node: what the report lacks of its summary
        self._summed: dict[str, int] = {}  # the process whose summary is kept, by node
        self.headlines: dict[str, str] = {}  # what nodes have to tell while they run
        self.restarts: dict[str, int] = {}
        self._sampled_s = 0.0
        self.started_s = time.monotonic()
        self.begun = False  # every process has worked once
        self.max_restarts = 0  # allowed whatever the graph says; for tests that kill on purpose

    def __enter__(self) -> "Supervisor":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Start every process, consumers first; frames flow once all are ready.

        Returns early when the run is asked to end; raises `RunError` when it cannot begin.
        """
        self.begin_all()
        deadline = time.monotonic() + max(node.start_s for node in self.plan.nodes)
        while not self.all_going and not self.end_requests:
            self.tick()
            if self.failure:
                raise RunError(self.failure)
            for managed in self.processes.values():
                if why := late(managed):
                    raise RunError(f"{managed.name}: {why}, see `fovea logs {managed.name}`")
            if time.monotonic() > deadline:
                raise RunError("the readers of a source have not heard it in all that time")
        self.begun = self.all_going
        self.started_s = time.monotonic()

    def tick(self) -> None:
        """Look after everything once, then wait for a moment or until a node says something."""
        self._health.tick()
        self._hear()
        self._see_off()
        self.control.tick()
        now_s = time.monotonic()
        for managed in self.processes.values():
            self._look_after(managed, now_s)
        if now_s - self._sampled_s >= SAMPLE_S:
            self._sampled_s = now_s
            self._sample()
        self._keep_a_spare()
        self.exchange.wait(TICK_S)

    def finish(self) -> None:
        """Let the sources end and what is under way arrive, for as long as something does.

        A run that was asked to end waits for `DRAIN_S` at most, and not at all in haste.
        """
        self.ending = True
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
        """Whether nothing is under way but to nodes that will not come back for it."""
        nobody = self._to_nobody()
        pairs = zip(self.ledger.edges, self.ledger.ends(), strict=True)
        return all(edge.sent == end or i in nobody for i, (edge, end) in enumerate(pairs))

    def _to_nobody(self) -> set[int]:
        """Indices of the edges into processes that have ended and do not start again."""
        gone = [
            s for s in self.processes.values() if not s.handle and (s.sources or not s.next_start_s)
        ]
        names = {node.name for managed in gone for node in managed.nodes}
        return {edge.index for edge in self.plan.edges if edge.target in names}

    def _write_off(self) -> None:
        """Count what was under way to a process that ended as lost: nobody else will."""
        for index in self._to_nobody():
            account = self.ledger.edges[index]
            account.lost_in_crash += account.in_flight

    @property
    def in_haste(self) -> bool:
        """Whether the run was asked to end more than once: nothing is waited for."""
        return self.end_requests > 1

    def stop(self) -> None:
        """Stop every process and what it started, collect what they have to say."""
        self.ending = True
        self._sample()
        self.spare.dismiss()
        handles = {managed.handle for managed in self.processes.values() if managed.handle}
        handles |= {*self.control.abort(), *self._leaving}
        for handle in handles:
            handle.tell(Stop())
        self._await_ends(handles, STOP_S)
        for handle in handles:
            if handle.ended() is None and not self.in_haste:
                log.warning("%s: did not stop; killed", handle.name)
            handle.kill()
        self._await_ends(handles, KILLED_S, hurries=False)
        for handle in handles:
            handle.bury(descendants=False)
        if self.handles:
            end_tagged(self._run.run_id)
        self._hear()
        for handle in handles:
            status = handle.ended()
            if status is not None and status >= 0 and not handle.left:
                log.warning("%s: ended by %s while it was stopped", handle.name, ending(status))
        for managed in self.processes.values():
            managed.handle = None
        self._leaving.clear()

    def close(self) -> None:
        """Nothing is left behind: no process, no socket, no memory."""
        try:
            self.stop()
        finally:
            try:
                self.exchange.close()
                leave = threading.Thread(target=self._hub.close, name="leave-bus", daemon=True)
                leave.start()
                leave.join(CLOSE_S)
            finally:
                self._run.release()

    def _await_ends(
        self, handles: set[ProcessHandle], limit_s: float, *, hurries: bool = True
    ) -> None:
        """Wait until all have ended, hearing what they say; not at all in haste."""
        late_s = time.monotonic() + limit_s
        while any(handle.ended() is None for handle in handles) and time.monotonic() < late_s:
            if hurries and self.in_haste:
                return
            self.exchange.wait(TICK_S)
            self._hear()

    def _keep_a_spare(self) -> None:
        if self.plan.clock == "realtime" and self.all_going:
            here = filter(self.plan.is_here, self.plan.nodes)
            self.spare.keep({node.operator.partition(":")[0] for node in here})

    def _hear(self) -> None:
        for handle in list(self.handles):
            for event in handle.events():
                self._take_note(handle, event)
            if handle.gone:
                self.handles.remove(handle)

    def _take_note(self, handle: ProcessHandle, event: Event) -> None:
        managed = self.processes.get(handle.name)
        if self.control.on_event(handle.pid, event):
            return
        if isinstance(event, Summary):
            self._keep_summary(handle, event)
        elif managed is None or managed.handle is not handle:
            return  # of a node that was removed, of a process that was replaced
        elif isinstance(event, Ready):
            handle.ready, handle.load_s = True, event.load_s
        elif isinstance(event, Finished) and event.node in handle.nodes:
            self._finished.add(event.node)
        elif isinstance(event, Headline) and event.node in handle.nodes:
            self.headlines[event.node] = harmless(event.words, MOST_HEADLINE)
        elif isinstance(event, Failed):
            self._note_failure(managed, event)

    def _keep_summary(self, handle: ProcessHandle, event: Summary) -> None:
        """Keep what the newest process says, which a source does twice."""
        node = event.node
        if node not in handle.nodes:
            return
        if self._summed.get(node) != handle.pid:
            self._summed[node], self.summaries[node] = handle.pid, {}
            self.left_out.pop(node, None)
        if event.left_out:
            self.left_out[node] = harmless(event.left_out)
            log.warning("%s: its summary is left out: %s", node, self.left_out[node])
        self.summaries[node].update(plain(event.figures))

    def _note_failure(self, managed: ManagedProcess, event: Failed) -> None:
        """What starting it again cannot mend ends the run: a graph that never began, a source."""
        unborn = self._is_first(managed) and not (managed.handle and managed.handle.ready)
        error = harmless(event.error)
        if event.expected and (unborn or managed.sources) and not self.failure:
            self.failure = error
        elif not self.failure:
            managed.last_words = error
            log.error("%s: %s", managed.name, managed.last_words)

    def _look_after(self, managed: ManagedProcess, now_s: float) -> None:
        if self.control.owns(managed):
            return
        if managed.handle is None and managed.sources and self.ending:
            self._finished |= managed.sources  # it need not come back to make no frames
        elif managed.handle is None:
            if managed.next_start_s and now_s >= managed.next_start_s:
                self._begin_again(managed, now_s)
        elif (status := managed.handle.ended()) is not None:
            managed.handle.bury()
            self._hear()  # what it said last is heard before its exit is handled
            self._bury(managed, status, now_s)
        elif managed.handle.ready and not managed.handle.going:
            self.let_go(managed)
        elif why := self.stalled(managed):
            log.error("%s: %s; killed", managed.name, why)
            managed.last_words = why
            managed.handle.kill(with_traceback=True)

    def _begin_again(self, managed: ManagedProcess, now_s: float) -> None:
        managed.next_start_s = 0.0
        try:
            self.begin(managed)
        except RunError as error:  # no memory, say: the others may go on until there is some
            log.error("%s", error)
            managed.next_start_s = now_s + UNABLE_S
        self.note()

    def _bury(self, managed: ManagedProcess, status: int, now_s: float) -> None:
        announced = managed.handle is not None and managed.handle.left
        self.vacate(managed)
        how, last = ending(status), f": {managed.last_words}" if managed.last_words else ""
        how += "" if announced or status else ", which it did not announce"
        managed.last_words = ""
        if not self.failure:
            log.warning("%s ended by %s, see `fovea logs %s`", managed.name, how, managed.name)
        rule = managed.nodes[0].restart
        managed.deaths.append(now_s)
        lived = managed.going_since_s and now_s - managed.going_since_s > HEALTHY_S
        managed.quick_deaths = 0 if lived else managed.quick_deaths + 1
        managed.going_since_s = 0.0
        recent = sum(1 for death in managed.deaths if now_s - death < rule.window_s)
        succeeded = announced and status == 0
        if self.failure:
            return
        if self.plan.clock == "lockstep":
            self.failure = f"{managed.name} ended by {how}: a lockstep run cannot go on{last}"
        elif rule.policy == "never" or (rule.policy == "on-failure" and succeeded):
            before = self.finished
            self._finished |= managed.sources
            if self.finished and not (before or succeeded or self.ending):
                self.failure = f"{managed.name} ended by {how}: no source is left{last}"
        elif recent > max(rule.most, self.max_restarts):
            self.failure = f"{managed.name} died {recent} times within {rule.window_s:.0f} s{last}"
        else:
            managed.next_start_s = now_s + min(
                5.0, rule.backoff_s * 2 ** min(managed.quick_deaths, 8)
            )
            self.restarts[managed.name] = self.restarts.get(managed.name, 0) + 1

    def _sample(self) -> None:
        for managed in self.processes.values():
            sample = managed.handle.sample() if managed.handle else None
            if sample:
                managed.samples.append(sample)
