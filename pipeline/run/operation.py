"""Operations: orders that a supervisor executes step by step while the graph runs."""

import logging
from abc import ABC, abstractmethod
from typing import Any

from pipeline.errors import FoveaError
from pipeline.protocol.codec import failed, refused
from pipeline.protocol.orders import Done, Refused, Result
from pipeline.protocol.supervision import Event
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.process_events import ProcessEvents
from pipeline.run.process_handle import ProcessHandle

log = logging.getLogger(__name__)


class Operation(ABC):
    """An order in progress; `result` is set when it is done."""

    kind = "order"

    def __init__(self) -> None:
        self.events = ProcessEvents()
        self.result: Result | None = None
        self.facts: dict[str, Any] = {}  # fields of the result, set as they become known

    @abstractmethod
    def advance(self) -> bool:
        """Advance as far as possible; return True at the end. Raises `FoveaError` on failure."""

    @abstractmethod
    def done(self) -> Done:
        """Return the result, at the end."""

    def clear_up(self, *, failed: bool) -> None:  # noqa: B027 - most hold nothing
        """Release what the operation holds, after any outcome."""

    def on_event(self, pid: int, event: Event) -> bool:
        """Handle an event; return True when nothing else needs it."""
        self.events.note(pid, event)
        return False

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether this operation handles exits of that process."""
        return False

    def abort(self) -> list[ProcessHandle]:
        """Abort at the end of the run; return processes that only this operation knows."""
        return []

    def tick(self) -> None:
        """Advance, and set the result at the end."""
        self.events.tick()
        try:
            if self.advance():
                self._finish("")
        except FoveaError as error:
            self._finish(str(error))
        except Exception as error:  # an order must not end the graph
            log.exception("%s broke", self.kind)
            self._finish(failed(error).reason)

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
