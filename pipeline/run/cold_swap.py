"""Cold swap, with a stop: for sources, shared processes and edges outside the local transport.

WARMING      the spare process finishes its imports: two imports cost a graph twice
   | launch a trial
CHECKING     it says whether operator and settings fit  ------> refused: nothing was touched
   | Fits: end it
REWARMING    the next spare process, while the node still works
   | stop the node
STOPPING     it ends, or is killed
   | start it by the new plan
STARTING     it opens its operators         ---------------+
   | Ready                                                 |
RUNNING      its first frame                               | failed
   | frame, or none comes                                  |
PROVING      its first frames are watched   ---------------+
   | enough frames                                         |
DONE                                         STOPPING_BACK   if it runs: it ends, or is killed
                                                | start it by the old plan
                                             STARTING_BACK
                                                | Ready
                                             RUNNING_BACK, then refused
"""

import time
from collections.abc import Callable
from enum import Enum, auto

from pipeline.errors import RunError
from pipeline.graph.plan import Plan
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.supervision import Event, Fits, Stop
from pipeline.run.probation import QUIET_S, Probation
from pipeline.run.process_handle import KILLED_S
from pipeline.run.swap_machine import SwapMachine
from pipeline.run.swap_target import SwapTarget

STOP_S = 5.0
LEAVE_S = 1.0  # for a trial process to exit


class ColdState(Enum):
    """The states of a cold swap, in the diagram above."""

    WARMING = auto()
    CHECKING = auto()
    REWARMING = auto()
    STOPPING = auto()
    STARTING = auto()
    RUNNING = auto()
    PROVING = auto()
    DONE = auto()
    STOPPING_BACK = auto()
    STARTING_BACK = auto()
    RUNNING_BACK = auto()


S = ColdState


class ColdSwap(SwapMachine[ColdState]):
    """One cold swap; `other` is the trial."""

    hot = False
    DONE = S.DONE
    UNDONE = (S.STOPPING, S.STARTING, S.RUNNING, S.PROVING)

    def __init__(
        self, target: SwapTarget, order: SwapOrder, now: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(target, order, S.WARMING, now)
        self.gone: set[int] = set()  # ids of processes that were told to stop
        self._killed = False
        self._steps = {
            S.WARMING: self._warming, S.CHECKING: self._checking, S.REWARMING: self._rewarming,
            S.STOPPING: self._stopping, S.STARTING: self._starting, S.RUNNING: self._running,
            S.PROVING: self._proving, S.STOPPING_BACK: self._stopping_back,
            S.STARTING_BACK: self._starting_back, S.RUNNING_BACK: self._running_back,
        }  # fmt: skip

    def on_event(self, pid: int, event: Event) -> bool:
        """Handle an event; what a process says that was told to stop is ignored."""
        return pid in self.gone or super().on_event(pid, event)

    def _give_back(self, *, failed: bool) -> None:
        """Leave a node that could not be started to the process manager."""
        self._target.send_also_to(0)
        if self.owned:
            self._target.retry_soon()
        self.owned = False

    # to the new operator

    def _warming(self) -> ColdState:
        if not self._spare_is_done():
            return S.WARMING
        self._before = self._target.plan
        self.other = self._target.launch_trial(self._target.changed(self._order))
        return S.CHECKING

    def _checking(self) -> ColdState:
        trial = self.other
        if trial is not None and not self._await(
            self.events.heard(trial, Fits), self._target.start_limit_s, "it was not checked", trial
        ):
            return S.CHECKING
        self.other = None
        if trial is not None:
            self._target.dismiss(trial, LEAVE_S)
        self._target.refresh_spare()
        return S.REWARMING

    def _rewarming(self) -> ColdState:
        if not self._spare_is_done():
            return S.REWARMING
        self._begin_stop()
        return S.STOPPING

    def _stopping(self) -> ColdState:
        if not self._has_stopped():
            return S.STOPPING
        plan = self._target.changed(self._order)  # with all live changes until its end
        self._target.forget_settings()
        self.facts["state"] = "begins anew: it was stopped and started"
        self._start(plan)
        return S.STARTING

    def _starting(self) -> ColdState:
        return S.RUNNING if self._is_ready() else S.STARTING

    def _running(self) -> ColdState:
        if not self._has_run():
            return S.RUNNING
        self._probation = Probation(self._target, self._order, self.events, self._now)
        return S.PROVING

    def _proving(self) -> ColdState:
        if not self._probation.over(self._target.working()):
            return S.PROVING
        self.facts["proven_frames"] = self._probation.frames
        return S.DONE

    # back to the old one

    def _roll_back(self, why: str) -> ColdState:
        self._failure = f"{why}; the old instance was restarted"
        self.facts["rolled_back"] = True
        self._target.keep_settings()
        if self._runs():
            self._begin_stop()
        return S.STOPPING_BACK

    def _stopping_back(self) -> ColdState:
        if self._runs() and not self._has_stopped():
            return S.STOPPING_BACK
        self._target.keep_settings()  # without live changes to the successor
        self._start(self._before)
        return S.STARTING_BACK

    def _starting_back(self) -> ColdState:
        return S.RUNNING_BACK if self._is_ready() else S.STARTING_BACK

    def _running_back(self) -> ColdState:
        if not self._has_run():
            return S.RUNNING_BACK
        raise RunError(self._failure)

    # what several states do

    def _runs(self) -> bool:
        try:
            self._target.working()
        except RunError:
            return False
        return True

    def _begin_stop(self) -> None:
        handle = self._target.working()
        self._stopped_s, self._killed, self.owned = self._now(), False, True
        self.gone.add(handle.pid)
        handle.tell(Stop())

    def _has_stopped(self) -> bool:
        handle = self._target.working()
        if handle.ended() is None and not self._late(STOP_S + KILLED_S):
            if self._late(STOP_S) and not self._killed:
                self._killed = True
                handle.kill()
            return False
        handle.kill()
        self._target.vacate()
        return True

    def _start(self, plan: Plan) -> None:
        self._handled = self._target.account.handled
        self._plan, self._handle = plan, self._target.start(plan)

    def _is_ready(self) -> bool:
        if not self._await(
            self._handle.ready, self._target.start_limit_s, "it was not ready", self._handle
        ):
            return False
        self._target.change_plan(self._plan)
        return True

    def _has_run(self) -> bool:
        """Whether a frame was handled, or no frame comes."""
        if not self._handle.going:
            self._target.let_go()
        ran = self._handle.going and self._target.account.handled > self._handled
        if not ran and not self._late(QUIET_S):
            self.events.check_alive(self._handle)
            return False
        self.facts["gap_ms"] = round(1000 * (self._now() - self._stopped_s), 1)
        return True
