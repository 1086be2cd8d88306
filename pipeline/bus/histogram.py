"""Latency histogram in a fixed block of memory: durations in, percentiles out.

Buckets grow by 2 % each, from 1 us to over ten minutes, so a percentile is accurate to 1 % in
constant memory. The memory may be shared: one process counts, others read.
"""

import math

import numpy as np
from numpy.typing import NDArray

BUCKETS = 1024
_GROWTH = math.log(1.02)


class Histogram:
    """A view of counts per bucket in external memory, (BUCKETS,) uint32."""

    def __init__(self, counts: NDArray[np.uint32]) -> None:
        self.counts = counts

    def add(self, duration_ns: int) -> None:
        """Count one duration; below a microsecond counts as one."""
        self.counts[min(BUCKETS - 1, int(math.log(max(duration_ns, 1000) / 1000) / _GROWTH))] += 1

    def since(self, earlier: NDArray[np.uint32]) -> "Histogram":
        """Return the counts since `earlier`, a copy of `counts`."""
        return Histogram(self.counts - earlier)

    @property
    def total(self) -> int:
        """Return the number of durations."""
        return int(self.counts.sum(dtype=np.int64))

    def percentile_ms(self, share: float) -> float:
        """Return the duration in ms below which a `share` (0..1) of all lie; 0 when there are none.

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
        """Return `{"p50": ms, "p99": ms}`, rounded to the microsecond."""
        return {
            "p50": round(self.percentile_ms(0.50), 3),
            "p99": round(self.percentile_ms(0.99), 3),
        }
