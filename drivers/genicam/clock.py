"""A camera's clock: its stamps and their arrival in, stamps of CLOCK_MONOTONIC out.

A frame arrives later than it was made, never earlier: the least difference between arrival and
stamp over the last frames is the offset between both clocks, to within the shortest transport.
Delays of single frames therefore do not show in the stamps, which always ascend.
"""

from collections import deque

FRAMES = 256  # over which the least difference is taken: a clock that drifts is followed
RATE_ERROR = 0.05  # a camera whose seconds differ more does not count nanoseconds
RATE_AFTER_NS = 1_000_000_000


class CameraClock:
    """Converts stamps of one camera; begins anew when its clock jumps back."""

    def __init__(self) -> None:
        self._behind_ns: deque[int] = deque(maxlen=FRAMES)
        self._first: tuple[int, int] | None = None  # stamp, arrival
        self._last_ns = self._told_ns = 0
        self.trusted = True  # False: its stamps are no nanoseconds; arrival is used

    def monotonic_ns(self, stamp_ns: int, arrived_ns: int) -> int:
        """When the camera stamped a frame, in this host's clock; its arrival if it has no clock.

        >>> clock = CameraClock()
        >>> clock.monotonic_ns(1_000, 51_000), clock.monotonic_ns(2_000, 53_500)
        (51000, 52000)
        """
        self._told_ns = max(self._converted(stamp_ns, arrived_ns), self._told_ns + 1)
        return self._told_ns

    def _converted(self, stamp_ns: int, arrived_ns: int) -> int:
        if stamp_ns <= 0 or not self.trusted:
            return arrived_ns
        if self._first is None or stamp_ns < self._last_ns:
            self._behind_ns.clear()
            self._first = (stamp_ns, arrived_ns)
        self._last_ns = stamp_ns
        if not self._counts_nanoseconds(stamp_ns, arrived_ns):
            self.trusted = False
            return arrived_ns
        self._behind_ns.append(arrived_ns - stamp_ns)
        return stamp_ns + min(self._behind_ns)

    def _counts_nanoseconds(self, stamp_ns: int, arrived_ns: int) -> bool:
        first_stamp_ns, first_arrived_ns = self._first or (stamp_ns, arrived_ns)
        elapsed_ns = arrived_ns - first_arrived_ns
        if elapsed_ns < RATE_AFTER_NS:
            return True
        return abs((stamp_ns - first_stamp_ns) / elapsed_ns - 1) < RATE_ERROR
