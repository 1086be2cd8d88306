"""Something that a supervisor carries out step by step while everything else goes on."""

import logging
import time
from collections.abc import Callable, Iterator
from typing import Any

from pipeline.errors import FoveaError, RunError
from pipeline.protocol.codec import refused
from pipeline.protocol.orders import Done, Refused, Result
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.process_handle import ProcessHandle, ending
from pipeline.run.process_manager import ProcessManager
from pipeline.text import error_text

log = logging.getLogger(__name__)


class Operation:
    """An order under way, driven by the supervisor's ticks; `result` is there when it is over."""

    kind = "order"
    subject = ""  # the node that it is about

    def __init__(self, manager: ProcessManager, steps: Iterator[None]) -> None:
        self.manager, self._steps = manager, steps
        self.result: Result | None = None
        self.facts: dict[str, Any] = {}
        self._said: dict[int, dict[str, dict[str, Any]]] = {}  # pid -> event -> what

    def tick(self) -> None:
        """Go one step on."""
        try:
            next(self._steps)
        except StopIteration:
            self._finish("")
        except FoveaError as error:
            self._finish(str(error))
        except Exception as error:  # an order must not end the graph
            log.exception("%s broke", self.kind)
            self._finish(f"it broke: {error_text(error)}")

    def on_event(self, pid: int, event: dict[str, Any]) -> bool:
        """Take note of an event; True when nobody else needs it."""
        self._said.setdefault(pid, {})[str(event.get("event"))] = event
        return False

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether exits of that process belong to this operation."""
        return False

    def abort(self) -> list[ProcessHandle]:
        """The run ends: processes that nobody else knows of."""
        return []

    def heard(self, handle: ProcessHandle) -> dict[str, dict[str, Any]]:
        """What a process has said, by event."""
        return self._said.setdefault(handle.pid, {})

    def until(
        self, done: Callable[[], bool], limit_s: float, what: str, *,
        of: ProcessHandle | None = None, must: bool = True,
    ) -> Iterator[None]:  # fmt: skip
        """Wait for something; raises `RunError` when it takes too long or that process ends."""
        late_s = time.monotonic() + limit_s
        while not done():
            if of is not None and (status := of.ended()) is not None:
                yield from self.last_words(of)
                if done():
                    return
                said = self.heard(of).get("failed", {}).get("error")
                raise RunError(said or f"{of.name}: it ended by {ending(status)}")
            if time.monotonic() > late_s:
                if must:
                    raise RunError(f"{self.subject or self.kind}: {what} within {limit_s:.0f} s")
                return
            yield

    def last_words(self, handle: ProcessHandle) -> Iterator[None]:
        """Hear all that an ended process said: why it failed, or what it did."""
        handle.bury()  # its socket is read to the end; the next tick hears what was in it
        yield

    def done(self) -> Done:
        """The result, once every step was taken."""
        raise NotImplementedError

    def _finish(self, why: str) -> None:
        rolled_back = bool(self.facts.get("rolled_back"))
        self.result = refused(why, rolled_back=rolled_back) if why else self.done()
        words = ", ".join(f"{k} {v}" for k, v in self.facts.items())
        log.log(
            logging.ERROR if why else logging.INFO, "%s: %s%s", self.kind, words,
            f": {self.result.reason}" if isinstance(self.result, Refused) else "",
        )  # fmt: skip
