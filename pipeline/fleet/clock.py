"""How far another host's clock is ahead: the times of questions and answers -> offset and error.

A question leaves at t1 by our clock, comes at t2 and its answer leaves at t3 by theirs, and arrives
at t4 by ours. However long either way took, the offset lies within half of what the ways took
together, so the fastest exchanges tell most (RFC 5905, section 8). Two crystals drift apart by up
to `DRIFT` meanwhile, by which an old exchange is trusted less.
"""

from collections import deque
from dataclasses import dataclass

DRIFT = 100e-6  # two crystals of 50 ppm
KEPT = 64


@dataclass(frozen=True)
class Estimate:
    """Their clock less ours; the truth lies within the error."""

    offset_ns: int
    error_ns: int
    round_trip_ns: int


class Offset:
    """The best of the last exchanges with one host."""

    def __init__(self) -> None:
        self._seen: deque[tuple[int, int, int]] = deque(maxlen=KEPT)  # when, offset, way

    def add(self, sent_ns: int, came_ns: int, left_ns: int, back_ns: int) -> None:
        """One exchange; what cannot be (an answer before its question) is left out."""
        way = (back_ns - sent_ns) - (left_ns - came_ns)
        if left_ns < came_ns or way < 0:
            return
        offset = ((came_ns - sent_ns) + (left_ns - back_ns)) // 2
        known = self.estimate(back_ns)
        if known and abs(offset - known.offset_ns) > known.error_ns + way // 2 + 1:
            self._seen.clear()  # the other clock began anew: what was known is of another one
        self._seen.append((back_ns, offset, way))

    def estimate(self, now_ns: int) -> Estimate | None:
        """The offset that is known best now; None without an exchange.

        >>> clock = Offset()
        >>> clock.add(0, 1_000_100, 1_000_200, 300)
        >>> clock.add(1000, 1_001_900, 1_002_000, 5000)
        >>> clock.estimate(5000)
        Estimate(offset_ns=1000000, error_ns=101, round_trip_ns=200)
        """
        best = min(
            ((way / 2 + DRIFT * (now_ns - at), offset, way) for at, offset, way in self._seen),
            default=None,
        )
        if best is None:
            return None
        error, offset, way = best
        return Estimate(offset, max(1, int(error) + 1), way)
