"""Table of sensor commands: RoiSchedules in, the window of each frame out."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.sensor import EMPTY_WINDOW
from pipeline.boxes import centres, roi_window
from pipeline.errors import DriverError
from pipeline.messages import Geometry, RoiSchedule

MOST_SCHEDULES = 256  # more than any horizon: one plan per frame, each a horizon long

Window = tuple[int, int, int, int]  # xyxy, sensor pixels


@dataclass(frozen=True)
class Commanded:
    """The window of one frame, the seq of its command (-1: none) and its status."""

    window: Window
    command_seq: int
    status: str  # ok | unplanned | stale


class RefusedSchedule(DriverError):
    """A sensor cannot obey a schedule. It goes on, by the commands before."""


class CommandTable:
    """The schedules sent to a sensor. `accept` and `look_up` may be called by two threads.

    A command made from frame j affects frames from j + 1 + `latency_frames` on. For each frame, the
    schedule made from the latest frame applies among those that cover it.
    """

    def __init__(
        self, stream: str, geometry: Geometry, *, latency_frames: int = 0, rois: int = 1
    ) -> None:
        self._stream, self._geometry, self._latency = stream, geometry, latency_frames
        self._rois = rois  # windows of one exposure
        self._guard = threading.Lock()
        self._schedules: list[RoiSchedule] = []  # newest last
        self._next_seq = 0
        self.accepted = self.late = self.foreign = 0

    def accept(self, schedule: RoiSchedule) -> None:
        """Accept a schedule, or count why it is refused; an empty one is ignored.

        Raises `RefusedSchedule` for more windows in one frame than the sensor reads.
        """
        if not len(schedule.windows):
            return
        with self._guard:
            if schedule.header.stream != self._stream:
                self.foreign += 1
                return
            check_count(schedule, self._rois)
            last = schedule.first_seq + len(schedule.windows) - 1
            if last < max(self._next_seq, self._earliest(schedule)):
                self.late += 1
            else:
                self.accepted += 1
            self._keep(schedule)

    def look_up(self, seq: int, *, held: Window) -> Commanded:
        """Return the window for frame `seq`, which is now exposed; later commands for it are late.

        Without a command the window stays `held`.
        """
        return self.look_up_all(seq, held=(held,))[0]

    def look_up_all(self, seq: int, *, held: Sequence[Window]) -> list[Commanded]:
        """Return the K windows for frame `seq`, as `look_up` does for one.

        Without a command they stay `held`, which has K. A window that the command does not have,
        or has without area, is empty: it is not read. The first one is always read.
        """
        with self._guard:
            self._next_seq = max(self._next_seq, seq + 1)
            self._schedules = [s for s in self._schedules if _end(s) > seq]
            covering = [s for s in self._schedules if s.first_seq <= seq]
            for schedule in reversed(covering):
                if self._earliest(schedule) <= seq:
                    made_from, wanted = schedule.header.seq, rows_of(schedule.windows)
                    found = self._commanded(wanted[seq - schedule.first_seq], len(held))
                    return [Commanded(window, made_from, "ok") for window in found]
            status = "stale" if covering else "unplanned"
            return [Commanded(window, -1, status) for window in held]

    def _keep(self, schedule: RoiSchedule) -> None:
        place = len(self._schedules)
        while place and self._schedules[place - 1].header.seq > schedule.header.seq:
            place -= 1
        self._schedules.insert(place, schedule)
        del self._schedules[:-MOST_SCHEDULES]

    def _earliest(self, schedule: RoiSchedule) -> int:
        return schedule.header.seq + 1 + self._latency

    def _commanded(self, wanted: NDArray[np.int32], count: int) -> list[Window]:
        """Windows on the grid for rows (k, 4), filled up with empty ones."""
        found = [EMPTY_WINDOW] * count
        for place, window in enumerate(wanted.astype(np.float32)):
            if place == 0 or (window[2:] > window[:2]).all():
                found[place] = roi_window(centres(window), self._geometry)
        return found


def rows_of(windows: NDArray[np.int32]) -> NDArray[np.int32]:
    """Windows of a schedule, (T, 4) or (T, K, 4), as (T, K, 4).

    >>> rows_of(np.zeros((7, 4), np.int32)).shape, rows_of(np.zeros((7, 3, 4), np.int32)).shape
    ((7, 1, 4), (7, 3, 4))
    """
    return windows[:, None] if windows.ndim == 2 else windows


def check_count(schedule: RoiSchedule, rois: int) -> None:
    """Raise `RefusedSchedule` for no or more windows in a frame than a sensor reads.

    An empty schedule has no frames, and passes.
    """
    if not len(schedule.windows):
        return
    count = rows_of(schedule.windows).shape[1]
    if not 1 <= count <= rois:
        wanted = "1 window" if rois == 1 else f"1 to {rois} windows"
        raise RefusedSchedule(
            f"schedule: expected {wanted} in one exposure, which is what this sensor reads, "
            f"got {count}"
        )


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
