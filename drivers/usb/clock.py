"""The board's clock told in the host's: samples of both in, stamps on CLOCK_MONOTONIC out."""

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

KEPT = 16  # samples
DRIFT = 100e-6  # of two quartz clocks at worst


class Sample(NamedTuple):
    """One exchange: the board's time lies between the two of the host."""

    asked_ns: int
    board_ns: int
    answered_ns: int

    @property
    def offset_ns(self) -> int:
        """Host minus board, if the answer was made half-way."""
        return (self.asked_ns + self.answered_ns) // 2 - self.board_ns

    def error_ns(self, now_ns: int) -> float:
        """The largest error of the offset by now: half the exchange, and drift since then."""
        return (self.answered_ns - self.asked_ns) / 2 + DRIFT * (now_ns - self.answered_ns)


class BoardClock:
    """The offset between both clocks, from the best of the last exchanges."""

    def __init__(self, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._now_ns = now_ns
        self._samples: deque[Sample] = deque(maxlen=KEPT)
        self._last_ns = 0

    def ask(self, board_ns: Callable[[], int]) -> None:
        """Exchange times with the board once."""
        asked_ns = self._now_ns()
        found_ns = board_ns()
        self._samples.append(Sample(asked_ns, found_ns, self._now_ns()))

    @property
    def age_s(self) -> float:
        """Time since the last exchange; infinite before the first."""
        if not self._samples:
            return float("inf")
        return (self._now_ns() - self._samples[-1].answered_ns) / 1e9

    @property
    def error_ms(self) -> float:
        """The largest error of a stamp that is made now."""
        now_ns = self._now_ns()
        return min((s.error_ns(now_ns) for s in self._samples), default=0.0) / 1e6

    def forget(self) -> None:
        """Drop all samples: the board was plugged in anew, and its clock starts again."""
        self._samples.clear()

    def stamp_ns(self, board_ns: int) -> int:
        """Return a time of the board on the host's clock: not in the future, never going back."""
        now_ns = self._now_ns()
        best = min(self._samples, key=lambda sample: sample.error_ns(now_ns), default=None)
        found_ns = now_ns if best is None else board_ns + best.offset_ns
        self._last_ns = max(self._last_ns + 1, min(found_ns, now_ns))
        return self._last_ns
