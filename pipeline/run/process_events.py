"""What the processes that an order waits for have said, and whether they have ended."""

from typing import Any, TypeVar

from pipeline.errors import RunError
from pipeline.protocol.supervision import Event, Failed
from pipeline.run.process_handle import ProcessHandle, ending

E = TypeVar("E", bound=Event)


class ProcessEvents:
    """The newest event of each class, by process."""

    def __init__(self) -> None:
        self._heard: dict[int, dict[type[Any], Event]] = {}
        self._ticks = 0
        self._ended: dict[int, int] = {}  # process id -> the tick that found it ended

    def tick(self) -> None:
        """All that came until now was noted."""
        self._ticks += 1

    def note(self, pid: int, event: Event) -> None:
        """Keep an event."""
        self._heard.setdefault(pid, {})[type(event)] = event

    def heard(self, handle: ProcessHandle, kind: type[E]) -> E | None:
        """The newest event of that class from a process, if there was one."""
        event = self._heard.get(handle.pid, {}).get(kind)
        return event if isinstance(event, kind) else None

    def forget(self, handle: ProcessHandle, kind: type[Event]) -> None:
        """Wait for a new event of that class."""
        self._heard.get(handle.pid, {}).pop(kind, None)

    def over(self, handle: ProcessHandle) -> bool:
        """Whether a process has ended and all that it said is noted.

        Its socket is read to the end when it is buried; the next tick notes what was in it.
        """
        if handle.ended() is None:
            return False
        if handle.pid not in self._ended:
            handle.bury()
            self._ended[handle.pid] = self._ticks
        return self._ticks > self._ended[handle.pid]

    def check_alive(self, handle: ProcessHandle) -> None:
        """Raise `RunError` with the reason once a process is over."""
        status = handle.ended()
        if status is not None and self.over(handle):
            failed = self.heard(handle, Failed)
            how = f"{handle.name}: it ended by {ending(status)}"
            raise RunError(failed.error if failed else how)
