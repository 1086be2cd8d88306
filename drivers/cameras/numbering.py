"""Number the exposures of a camera: stamps of its frames in, `seq` out.

Histories are indexed by `seq`, so a lost frame must leave a gap as wide as the time it lasted.
"""

GAP_FRAMES, GAP_S = 4, 0.5  # beyond both, frames are missing that the camera did not count
SMOOTHING = 8  # frames that the period is averaged over
ROUNDING = 1e-6  # of an exposure


class ExposureNumbers:
    """Numbers from 0 on; each is the number of exposures that fit into the time since the first.

    With a rate of its own, an exposure's number follows from its stamp. Without (0), it is the
    number of the camera's frame: frames that nobody got are counted by the camera, and those of
    an outage are estimated from its usual period. In lockstep time stands still between two
    exposures, so there is no gap.
    """

    def __init__(self, rate_hz: float, *, realtime: bool) -> None:
        self._rate_hz, self._realtime = rate_hz, realtime
        self._first_ns = self._last_ns = 0
        self._period_ns = 0.0  # of the camera's frames; 0: not known
        self._last = -1
        self.late = 0  # exposures that were missed because they were asked for too late
        self.missing = 0  # others: the camera was away, or slower than the rate

    @property
    def elapsed(self) -> int:
        """Exposures since the first one, including those that were missed."""
        return self._last + 1

    @property
    def spanned_s(self) -> float:
        """Time from the first stamp to the last."""
        return (self._last_ns - self._first_ns) / 1e9

    def due_ns(self) -> int:
        """When the next exposure is due; 0: as soon as there is a frame."""
        if not (self._realtime and self._rate_hz and self._last >= 0):
            return 0
        return self._first_ns + round((self._last + 1) * 1e9 / self._rate_hz)

    def number(self, *, stamp_ns: int, skipped: int, asked_ns: int) -> int:
        """The number of the exposure made from a frame that was asked for at `asked_ns`."""
        if self._last < 0:
            self._first_ns = stamp_ns
            seq = 0
        elif not self._realtime:
            seq = self._last + 1
        elif self._rate_hz:
            seq = self._by_stamp(stamp_ns, asked_ns)
        else:
            seq = self._by_frame(stamp_ns, skipped)
        self._last, self._last_ns = seq, stamp_ns
        return seq

    def _by_stamp(self, stamp_ns: int, asked_ns: int) -> int:
        passed = (stamp_ns - self._first_ns) * self._rate_hz / 1e9
        seq = max(self._last + 1, int(passed + ROUNDING))
        gap = seq - self._last - 1
        waited = (asked_ns - self.due_ns()) * self._rate_hz / 1e9
        late = min(gap, max(0, int(waited + ROUNDING)))
        self.late += late
        self.missing += gap - late
        return seq

    def _by_frame(self, stamp_ns: int, skipped: int) -> int:
        frames, passed_ns = skipped + 1, stamp_ns - self._last_ns
        missing = 0
        if self._period_ns:
            over_ns = passed_ns - frames * self._period_ns
            if over_ns > max(GAP_FRAMES * self._period_ns, GAP_S * 1e9):
                missing = round(over_ns / self._period_ns)
        if not missing:
            found_ns = passed_ns / frames
            weight = SMOOTHING if self._period_ns else 1
            self._period_ns += (found_ns - self._period_ns) / weight
        self.late += skipped
        self.missing += missing
        return self._last + frames + missing
