"""Play a source like a sensor: source frames in, one picture per exposure at its due time out.

In realtime, exposure k is due at start + k / rate whatever the reader does: exposures that are not
ready or read in time are skipped and counted, so time is never stretched. Lockstep never waits.
"""

import math
import threading
import time
from dataclasses import dataclass

from drivers.simulated.pace import Pace
from drivers.simulated.prefetch import Prefetch, Ready
from drivers.source import FrameSource


@dataclass(frozen=True, kw_only=True)
class Timing:
    """When exposures happen and which source frames they integrate."""

    rate_hz: float
    interval: int = 1  # base frames per exposure
    averaged: bool = False  # all of them, told by the last; otherwise only the first
    frames: int = 0  # base frames until the end; 0: as long as the source lasts
    loop: bool = False
    realtime: bool = False


class Playback:
    """`take` a picture, use it, say `done`; one thread. `stop` may come from another."""

    def __init__(self, source: FrameSource, timing: Timing) -> None:
        self._source, self._timing = source, timing
        self._ahead = Prefetch(source)
        self._pace = Pace(timing.rate_hz, timing.interval)
        self._end = _frames(source, timing)
        self._stopped = threading.Event()
        self._cost_ns = 0.0
        self._next: int | None = None
        self._last_seq = -1
        self.skipped = self.late = self.elapsed = 0  # base frames
        self._ask(timing.interval - 1 if timing.averaged else 0)

    def take(self) -> tuple[Ready, int] | None:
        """The next picture at its time, and its stamp; None at the end and after `stop`.

        The stamp is the later of when it was due and when it was ready. In lockstep an exposure is
        due when it is asked for.
        """
        if self._next is not None:
            self._ask(self._next)
            self._next = None
        while True:
            if self._stopped.is_set() or (self._end is not None and self._asked >= self._end):
                return None
            try:
                ready = self._ahead.take()
            except IndexError:
                self._end = self._asked
                return None
            self._cost_ns += (ready.cost_ns - self._cost_ns) / (4 if self._cost_ns else 1)
            now_ns = time.monotonic_ns()
            if not self._pace.begun:
                self._pace.begin(ready.seq, now_ns)
            if not (self._timing.realtime and self._missed(ready, now_ns)):
                return self._at_its_time(ready, now_ns)
            self._ask(self._following(ready.seq, now_ns))

    def done(self, ready: Ready) -> None:
        """The picture may be overwritten by the next.

        The next picture is started by the next `take`: until then this exposure is being sent, and
        rendering must not compete with it for a core.
        """
        self._next = self._following(ready.seq, time.monotonic_ns())

    def stop(self) -> None:
        """Make `take` return None, also one that is waiting."""
        self._stopped.set()

    def close(self) -> None:
        """End the thread."""
        self._stopped.set()
        self._ahead.close()

    def _missed(self, ready: Ready, now_ns: int) -> bool:
        """Whether the reader missed a timely picture, as the next exposure is already due.

        A picture that the source delivered late is still the latest one, so it is not skipped.
        """
        passed = self._pace.passed
        return passed(ready.seq, now_ns) and not passed(ready.seq, ready.ready_ns)

    def _at_its_time(self, ready: Ready, now_ns: int) -> tuple[Ready, int] | None:
        stamp_ns = now_ns
        if self._timing.realtime:
            due_ns = self._pace.due_ns(ready.seq)
            if now_ns < due_ns and self._stopped.wait((due_ns - now_ns) / 1e9):
                return None
            stamp_ns = max(due_ns, ready.ready_ns)
        self._account(ready.seq)
        return ready, stamp_ns

    def _account(self, seq: int) -> None:
        interval, averaged = self._timing.interval, self._timing.averaged
        gap = seq - self._last_seq
        late = (gap - 1) // interval * interval
        self.late += late
        self.skipped += late if averaged else gap - 1
        self.elapsed = seq + 1 if averaged else seq + interval
        self._last_seq = seq

    def _following(self, seq: int, now_ns: int) -> int:
        """The exposure to make next: the first whose picture comes less than a period late."""
        interval = self._timing.interval
        if not self._timing.realtime:
            return seq + interval
        behind_ns = max(0.0, self._cost_ns - interval * 1e9 / self._timing.rate_hz)
        return self._pace.following(seq, now_ns + round(behind_ns))

    def _ask(self, seq: int) -> None:
        self._asked = seq
        if self._end is not None and seq >= self._end:
            return
        timing, source = self._timing, self._source
        first = seq - timing.interval + 1 if timing.averaged else seq
        speed = _speed(source, timing)
        indices = [math.floor(k * speed + 1e-6) for k in range(first, seq + 1)]
        if timing.loop and source.length:
            indices = [index % source.length for index in indices]
        self._ahead.ask(seq, indices)


def _frames(source: FrameSource, timing: Timing) -> int | None:
    """Base frames until the end, None for ever."""
    lasting = None
    if source.length is not None and not timing.loop:
        lasting = math.ceil(source.length / _speed(source, timing) - 1e-6)
    if timing.frames:
        return timing.frames if lasting is None else min(timing.frames, lasting)
    return lasting


def _speed(source: FrameSource, timing: Timing) -> float:
    """Source frames per base frame; a source without a rate goes frame by frame."""
    return source.rate_hz / timing.rate_hz if source.rate_hz else 1.0
