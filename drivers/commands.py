"""Table of sensor commands: RoiSchedules in, the window of each frame out."""

import threading
from dataclasses import dataclass

import numpy as np

from pipeline.boxes import centres, roi_window
from pipeline.messages import Geometry, RoiSchedule

MOST_SCHEDULES = 256  # more than any horizon: one plan per frame, each a horizon long

Window = tuple[int, int, int, int]  # xyxy, sensor pixels


@dataclass(frozen=True)
class Commanded:
    """The window of one frame, the seq of its command (-1: none) and its status."""

    window: Window
    command_seq: int
    status: str  # ok | unplanned | stale


class CommandTable:
    """The schedules sent to a sensor. `accept` and `look_up` may be called by two threads.

    A command made from frame j affects frames from j + 1 + `latency_frames` on. For each frame, the
    schedule made from the latest frame applies among those that cover it.
    """

    def __init__(self, stream: str, geometry: Geometry, *, latency_frames: int = 0) -> None:
        self._stream, self._geometry, self._latency = stream, geometry, latency_frames
        self._guard = threading.Lock()
        self._schedules: list[RoiSchedule] = []  # newest last
        self._next_seq = 0
        self.accepted = self.late = self.foreign = 0

    def accept(self, schedule: RoiSchedule) -> None:
        """Accept a schedule, or count why it is refused; an empty one is ignored."""
        if not len(schedule.windows):
            return
        with self._guard:
            last = schedule.first_seq + len(schedule.windows) - 1
            if schedule.header.stream != self._stream:
                self.foreign += 1
                return
            if last < max(self._next_seq, self._earliest(schedule)):
                self.late += 1
            else:
                self.accepted += 1
            self._keep(schedule)

    def look_up(self, seq: int, *, held: Window) -> Commanded:
        """Return the window for frame `seq`, which is now exposed; later commands for it are late.

        Without a command the window stays `held`.
        """
        with self._guard:
            self._next_seq = max(self._next_seq, seq + 1)
            self._schedules = [s for s in self._schedules if _end(s) > seq]
            covering = [s for s in self._schedules if s.first_seq <= seq]
            for schedule in reversed(covering):
                if self._earliest(schedule) <= seq:
                    return Commanded(self._window(schedule, seq), schedule.header.seq, "ok")
            return Commanded(held, -1, "stale" if covering else "unplanned")

    def _keep(self, schedule: RoiSchedule) -> None:
        place = len(self._schedules)
        while place and self._schedules[place - 1].header.seq > schedule.header.seq:
            place -= 1
        self._schedules.insert(place, schedule)
        del self._schedules[:-MOST_SCHEDULES]

    def _earliest(self, schedule: RoiSchedule) -> int:
        return schedule.header.seq + 1 + self._latency

    def _window(self, schedule: RoiSchedule, seq: int) -> Window:
        wanted = schedule.windows[seq - schedule.first_seq].astype(np.float32)
        return roi_window(centres(wanted), self._geometry)


def counts_of(table: CommandTable | None) -> dict[str, int]:
    """Counts of the commands so far, for a sensor's summary; all 0 before there is a table.

    >>> counts_of(None)
    {'accepted': 0, 'late': 0, 'foreign': 0}
    """
    if table is None:
        return {"accepted": 0, "late": 0, "foreign": 0}
    return {"accepted": table.accepted, "late": table.late, "foreign": table.foreign}


def _end(schedule: RoiSchedule) -> int:
    return schedule.first_seq + len(schedule.windows)
