"""Probation of a successor: check that its first frames are handled, and fast enough."""

import time
from collections.abc import Callable

from pipeline.errors import RunError
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.supervision import Failed
from pipeline.run.process_events import ProcessEvents
from pipeline.run.process_handle import ProcessHandle, ending
from pipeline.run.swap_target import SwapTarget

STUCK_S = 2.0  # without progress while messages wait
LOOK_S = 0.5  # upper limit per check, since a late supervisor was stopped itself
QUIET_S = 10.0  # probation ends after this time without messages
SOONEST = 5  # frames before a successor may be judged too slow
SLOWER, LEAST_BUDGET_MS = 3.0, 20.0  # default budget relative to the predecessor


class Probation:
    """The probation of one successor, from its takeover."""

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
        """Return the number of frames finished since the takeover."""
        return int(self._target.account.handled - self._first)

    def over(self, handle: ProcessHandle) -> bool:
        """Check once; return whether probation is passed. Raises `RunError` when it fails."""
        name = self._target.node.name
        if (status := handle.ended()) is not None:
            if self._events.over(handle):
                failed = self._events.heard(handle, Failed)
                why = f" {failed.error}" if failed else ""
                raise RunError(f"{name}: the new instance ended by {ending(status)}{why}")
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
            raise RunError(f"{name}: the new instance finished no frame for {self._still_s:.1f} s")
        enough = self.frames >= self._order.probation or self._target.run_ends
        return enough or self._still_s > QUIET_S

    def _check_budget(self) -> None:
        times = self._target.account.histograms["handler"].since(self._earlier)
        slow_ms = times.percentile_ms(0.5)
        if self.frames >= min(SOONEST, self._order.probation) and slow_ms > self._budget_ms:
            raise RunError(
                f"{self._target.node.name}: the new instance takes {slow_ms:.1f} ms a frame, "
                f"expected at most {self._budget_ms:.1f} ms"
            )
