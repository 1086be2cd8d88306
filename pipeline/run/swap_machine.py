"""Base of both kinds of swap: a state machine that the supervisor's ticks advance."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Generic, TypeVar

from pipeline.errors import RunError
from pipeline.graph.plan import Plan
from pipeline.protocol.orders import SwapOrder, SwapResult
from pipeline.protocol.supervision import Event, Failed, Ready
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.operation import Operation
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.swap_target import SwapTarget

State = TypeVar("State", bound=Enum)
SPARE_S = 10.0  # for the spare process to finish its imports


class SwapMachine(Operation, Generic[State]):
    """A swap as a state machine, with the actions that both kinds share.

    There is a method per state, which returns the next state, or its own while it waits. A failure
    ends the swap; in the states of `undone` it starts the rollback.
    """

    kind = "swap"
    hot: bool  # whether a successor stands by
    DONE: State
    UNDONE: tuple[State, ...]

    def __init__(
        self, target: SwapTarget, order: SwapOrder, first: State, now: Callable[[], float]
    ) -> None:
        super().__init__()
        self.facts |= {"node": order.node, "hot": self.hot}
        self._target, self._order, self._now = target, order, now
        self.state, self._since_s = first, now()
        self.other: ProcessHandle | None = None  # the inactive process
        self.owned = False  # whether the swap handles exits of the active process
        self._before: Plan = target.plan
        self._failure = ""  # reason of the rollback
        self._steps: Mapping[State, Callable[[], State]] = {}
        target.refresh_spare()

    def advance(self) -> bool:
        """Advance as far as possible; return True when done. Raises `FoveaError` on failure."""
        while self.state is not self.DONE:
            try:
                following = self._steps[self.state]()
            except RunError as error:
                if self.state not in self.UNDONE:
                    raise
                following = self._roll_back(str(error))
            if following is self.state:
                return False
            self.state, self._since_s = following, self._now()
        return True

    def done(self) -> SwapResult:
        """Return the result of the swap."""
        return SwapResult(**self.facts)

    def clear_up(self, *, failed: bool) -> None:
        """End the inactive process."""
        if self.other is not None:
            self._target.dismiss(self.other)
            self.other = None
        self._give_back(failed=failed)

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether this swap handles exits of that process."""
        return self.owned and self._target.runs_in(managed)

    def on_event(self, pid: int, event: Event) -> bool:
        """Handle an event; return True when nothing else needs it."""
        if self.other is not None and self.other.pid == pid:
            self.events.note(pid, event)
            if isinstance(event, Ready):
                self.other.ready, self.other.load_s = True, event.load_s
            return True
        if not self._target.works_as(pid):
            return False
        self.events.note(pid, event)
        return self.owned and isinstance(event, Failed)

    def abort(self) -> list[ProcessHandle]:
        """Abort at the end of the run; return the inactive process, to be ended as well."""
        return [self.other] if self.other else []

    @abstractmethod
    def _give_back(self, *, failed: bool) -> None:
        """Restore the graph's invariants at the end of a swap."""

    @abstractmethod
    def _roll_back(self, why: str) -> State:
        """Start the rollback; return its first state."""

    @property
    def _name(self) -> str:
        return self._target.node.name

    def _late(self, limit_s: float) -> bool:
        return self._now() - self._since_s > limit_s

    def _await(self, done: object, limit_s: float, what: str, of: ProcessHandle) -> bool:
        """Return whether it is done; raises `RunError` after the limit or if a process ends."""
        if done:
            return True
        self.events.check_alive(of)
        if self._late(limit_s):
            raise RunError(f"{self._name}: {what} within {limit_s:.0f} s")
        return False

    def _spare_is_done(self) -> bool:
        """Whether the spare process has finished its imports, or was dropped because it hangs."""
        if self._target.spare_is_warming():
            if not self._late(SPARE_S):
                return False
            self._target.drop_spare()
        return True
