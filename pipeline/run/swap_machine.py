"""Base of both kinds of swap: a state machine that the supervisor's ticks advance."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any, Generic, TypeVar

from pipeline.errors import RunError
from pipeline.graph.plan import Plan
from pipeline.protocol.orders import SwapOrder
from pipeline.run.process_events import ProcessEvents
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.swap_target import SwapTarget

State = TypeVar("State", bound=Enum)
SPARE_S = 10.0  # for the spare process to finish its imports


class SwapMachine(ABC, Generic[State]):
    """A state machine of a swap, with the actions that both kinds share.

    There is a method per state, which returns the next state, or its own while it waits. A failure
    ends the swap; in the states of `undone` it starts the rollback.
    """

    DONE: State
    UNDONE: tuple[State, ...]

    def __init__(
        self, target: SwapTarget, order: SwapOrder, events: ProcessEvents, facts: dict[str, Any],
        first: State, now: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._target, self._order, self._events, self._now = target, order, events, now
        self.facts = facts
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

    @abstractmethod
    def give_back(self, *, failed: bool) -> None:
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
        self._events.check_alive(of)
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
