"""An order that a supervisor carries out, a little with each of its ticks, while the graph runs."""

import logging
from abc import ABC, abstractmethod
from typing import Any

from pipeline.errors import FoveaError
from pipeline.protocol.codec import refused
from pipeline.protocol.orders import Done, Refused, Result
from pipeline.protocol.supervision import Event
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.process_events import ProcessEvents
from pipeline.run.process_handle import ProcessHandle
from pipeline.text import error_text

log = logging.getLogger(__name__)


class Operation(ABC):
    """An order under way; `result` is there when it is over."""

    kind = "order"

    def __init__(self) -> None:
        self.events = ProcessEvents()
        self.result: Result | None = None
        self.facts: dict[str, Any] = {}  # fields of the result, as they become known

    @abstractmethod
    def advance(self) -> bool:
        """Do what can be done now; True at the end. Raises `FoveaError` for why it failed."""

    @abstractmethod
    def done(self) -> Done:
        """The result, at the end."""

    def clear_up(self, *, failed: bool) -> None:  # noqa: B027 - most hold nothing
        """Give back what the operation holds, whatever became of it."""

    def on_event(self, pid: int, event: Event) -> bool:
        """Take note of an event; True when nothing else needs it."""
        self.events.note(pid, event)
        return False

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether exits of that process belong to this operation."""
        return False

    def abort(self) -> list[ProcessHandle]:
        """The run ends: processes that only this operation knows."""
        return []

    def tick(self) -> None:
        """Go on; where that ends it, there is a result."""
        self.events.tick()
        try:
            if self.advance():
                self._finish("")
        except FoveaError as error:
            self._finish(str(error))
        except Exception as error:  # an order must not end the graph
            log.exception("%s broke", self.kind)
            self._finish(f"it broke: {error_text(error)}")

    def _finish(self, why: str) -> None:
        self.clear_up(failed=bool(why))
        rolled_back = bool(self.facts.pop("rolled_back", False))
        self.result = refused(why, rolled_back=rolled_back) if why else self.done()
        words = ", ".join(f"{k} {v}" for k, v in self.facts.items())
        if isinstance(self.result, Refused):
            back = ", rolled back" if rolled_back else ""
            log.error("%s: %s%s: %s", self.kind, words, back, self.result.reason)
        else:
            log.info("%s: %s", self.kind, words)
