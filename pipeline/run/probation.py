"""The first frames of a successor, watched: whether it works, in time, and does not hang."""

import time
from collections.abc import Callable

from pipeline.errors import RunError
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.supervision import Failed
from pipeline.run.process_events import ProcessEvents
from pipeline.run.process_handle import ProcessHandle, ending
from pipeline.run.swap_target import SwapTarget

STUCK_S = 2.0  # with messages waiting
LOOK_S = 0.5  # counted between two looks at most: a supervisor that looks late was stopped too
QUIET_S = 10.0  # without messages: then probation is over
SOONEST = 5  # frames after which a successor may be found too slow
SLOWER, LEAST_BUDGET_MS = 3.0, 20.0  # than its predecessor, when no budget is given


class Probation:
    """The watch over one successor, from when it takes over."""

    def __init__(
        self, target: SwapTarget, order: SwapOrder, events: ProcessEvents,
        now: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._target, self._order, self._events, self._now = target, order, events, now
        account = target.account
        self._first = self._handled = account.handled
        self._earlier = account.histograms["handler"].counts.copy()
        self._budget_ms = order.budget_ms or max(
            LEAST_BUDGET_MS, SLOWER * account.histograms["handler"].percentile_ms(0.5)
        )
        self._stuck_s = max(STUCK_S, order.budget_ms / 1000)
        self._still_s, self._seen_s = 0.0, now()

    @property
    def frames(self) -> int:
        """How many the node has finished since."""
        return int(self._target.account.handled - self._first)

    def over(self, handle: ProcessHandle) -> bool:
        """Look once: whether it has proven itself; raises `RunError` when it is not good enough."""
        name = self._target.node.name
        if (status := handle.ended()) is not None:
            if self._events.over(handle):
                failed = self._events.heard(handle, Failed)
                why = f" {failed.error}" if failed else ""
                raise RunError(f"{name}: the new part ended by {ending(status)}{why}")
            return False
        if problem := self._target.stalled():
            raise RunError(problem)
        self._seen_s, before_s = self._now(), self._seen_s
        self._still_s += min(self._seen_s - before_s, LOOK_S)
        if self._target.account.handled != self._handled:
            self._still_s, self._handled = 0.0, self._target.account.handled
            self._check_budget()
        waiting = self._target.messages_wait and self._target.account.condition != "credit"
        if self._still_s > self._stuck_s and waiting:
            raise RunError(f"{name}: the new part finished no frame for {self._still_s:.1f} s")
        enough = self.frames >= self._order.probation or self._target.run_ends
        return enough or self._still_s > QUIET_S

    def _check_budget(self) -> None:
        times = self._target.account.histograms["handler"].since(self._earlier)
        slow_ms = times.percentile_ms(0.5)
        if self.frames >= min(SOONEST, self._order.probation) and slow_ms > self._budget_ms:
            raise RunError(
                f"{self._target.node.name}: the new part takes {slow_ms:.1f} ms a frame, expected "
                f"at most {self._budget_ms:.1f} ms"
            )
