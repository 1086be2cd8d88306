"""Record events and ends of the processes that an order waits for."""

from typing import Any, TypeVar

from pipeline.errors import RunError
from pipeline.protocol.supervision import Event, Failed
from pipeline.run.process_handle import ProcessHandle, ending

E = TypeVar("E", bound=Event)


class ProcessEvents:
    """The latest event of each class, by process."""

    def __init__(self) -> None:
        self._heard: dict[int, dict[type[Any], Event]] = {}
        self._ticks = 0
        self._ended: dict[int, int] = {}  # process id -> the tick that found it ended

    def tick(self) -> None:
        """Advance the tick: all events so far are recorded."""
        self._ticks += 1

    def note(self, pid: int, event: Event) -> None:
        """Record an event."""
        self._heard.setdefault(pid, {})[type(event)] = event

    def heard(self, handle: ProcessHandle, kind: type[E]) -> E | None:
        """Return the latest event of that class from a process, if there was one."""
        event = self._heard.get(handle.pid, {}).get(kind)
        return event if isinstance(event, kind) else None

    def forget(self, handle: ProcessHandle, kind: type[Event]) -> None:
        """Discard an event, to wait for a new one of that class."""
        self._heard.get(handle.pid, {}).pop(kind, None)

    def over(self, handle: ProcessHandle) -> bool:
        """Whether a process has ended and all its events are recorded.

        `bury` reads its socket to the end; the next tick records the events.
        """
        if handle.ended() is None:
            return False
        if handle.pid not in self._ended:
            handle.bury()
            self._ended[handle.pid] = self._ticks
        return self._ticks > self._ended[handle.pid]

    def check_alive(self, handle: ProcessHandle) -> None:
        """Raise `RunError` with the reason once a process has ended."""
        status = handle.ended()
        if status is not None and self.over(handle):
            failed = self.heard(handle, Failed)
            how = f"{handle.name}: it ended by {ending(status)}"
            raise RunError(failed.error if failed else how)
