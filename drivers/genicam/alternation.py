"""Whose turn it is: commands in, aims out: the context and then the ROI of each exposure."""

import threading
import time
from dataclasses import dataclass

from drivers.commands import Commanded, CommandTable, Window


@dataclass(frozen=True, kw_only=True)
class Aim:
    """What a frame is for."""

    seq: int  # of the exposure
    roi: Commanded | None  # None: the context


class Alternation:
    """Context and ROI in turn. In real time, exposure k is due k periods after the first one.

    An exposure whose time has passed is not made: its number is left out and counted as late, so
    that the numbers follow time. Without a rate, and in lockstep, every number is used.
    """

    def __init__(
        self, commands: CommandTable, window: Window, rate_hz: float, stopped: threading.Event
    ) -> None:
        self._window = window  # of the last aim: it is held where no command covers
        self.late = 0
        self._commands, self._stopped = commands, stopped
        self._period_ns = round(1e9 / rate_hz) if rate_hz else 0
        self._first_ns = 0
        self._seq = -1
        self._roi_next = False

    def restart(self) -> None:
        """Begin with a context: the frames of the aims before are lost."""
        self._roi_next = False

    def next(self) -> Aim | None:
        """The next aim, a context at its time; None: stopped while waiting for it."""
        if self._roi_next:
            self._roi_next = False
            found = self._commands.look_up(self._seq, held=self._window)
            self._window = found.window
            return Aim(seq=self._seq, roi=found)
        if not self._await_turn():
            return None
        self._roi_next = True
        return Aim(seq=self._seq, roi=None)

    def _await_turn(self) -> bool:
        now_ns = time.monotonic_ns()
        self._seq += 1
        if self._period_ns:
            self._first_ns = self._first_ns or now_ns
            missed = (now_ns - self._first_ns) // self._period_ns - self._seq
            if missed > 0:
                self.late += missed
                self._seq += missed
            due_ns = self._first_ns + self._seq * self._period_ns
            return not self._stopped.wait(max(due_ns - now_ns, 0) / 1e9)
        return not self._stopped.is_set()
