"""Latencies in a fixed piece of memory: durations in, percentiles out.

Buckets grow by 2 %, from 1 us to beyond ten minutes, so a percentile is exact to 1 % and memory
never grows. The memory may be shared: one process counts, any other reads.
"""

import math

import numpy as np
from numpy.typing import NDArray

BUCKETS = 1024
_GROWTH = math.log(1.02)


class Histogram:
    """Counts per bucket over someone else's memory, (BUCKETS,) uint32."""

    def __init__(self, counts: NDArray[np.uint32]) -> None:
        self.counts = counts

    def add(self, duration_ns: int) -> None:
        """Count one duration; below a microsecond counts as one."""
        self.counts[min(BUCKETS - 1, int(math.log(max(duration_ns, 1000) / 1000) / _GROWTH))] += 1

    def since(self, earlier: NDArray[np.uint32]) -> "Histogram":
        """What was counted since a copy of `counts` was taken."""
        return Histogram(self.counts - earlier)

    @property
    def total(self) -> int:
        """How many durations were counted."""
        return int(self.counts.sum(dtype=np.int64))

    def percentile_ms(self, share: float) -> float:
        """The duration below which `share` (0..1) of all lie; 0 when there are none.

        >>> h = Histogram(np.zeros(BUCKETS, np.uint32))
        >>> for ms in range(1, 101): h.add(ms * 1_000_000)
        >>> round(h.percentile_ms(0.5))
        50
        """
        if not self.total:
            return 0.0
        bucket = int(np.searchsorted(np.cumsum(self.counts), share * self.total))
        return math.exp((min(bucket, BUCKETS - 1) + 0.5) * _GROWTH) / 1000

    def summary(self) -> dict[str, float]:
        """`{"p50": ms, "p99": ms}`, rounded to the microsecond."""
        return {
            "p50": round(self.percentile_ms(0.50), 3),
            "p99": round(self.percentile_ms(0.99), 3),
        }
