"""Schedule of exposures: frame numbers in, due times out, unaffected by delays."""


class Pace:
    """Exposure k is due at origin + k / rate. Only every `interval`-th one is made."""

    def __init__(self, rate_hz: float, interval: int) -> None:
        self._period_ns = 1e9 / rate_hz
        self._interval = interval
        self._origin_ns: int | None = None

    @property
    def begun(self) -> bool:
        """Whether the origin is known."""
        return self._origin_ns is not None

    def begin(self, seq: int, now_ns: int) -> None:
        """Exposure `seq` is due now."""
        self._origin_ns = now_ns - round(seq * self._period_ns)

    def due_ns(self, seq: int) -> int:
        """When exposure `seq` takes place; only after `begin`."""
        return (self._origin_ns or 0) + round(seq * self._period_ns)

    def passed(self, seq: int, now_ns: int) -> bool:
        """Whether the exposure after `seq` is due already, so that `seq` is lost."""
        return now_ns >= self.due_ns(seq + self._interval)

    def following(self, seq: int, now_ns: int) -> int:
        """The next exposure after `seq` that is not due before `now_ns`.

        >>> pace = Pace(rate_hz=1e9, interval=4)
        >>> pace.begin(0, 100)
        >>> pace.following(0, 90), pace.following(0, 105), pace.following(4, 113)
        (4, 8, 16)
        """
        step = self._interval
        behind_ns = now_ns - self.due_ns(seq + step)
        if behind_ns <= 0:
            return seq + step
        groups = -(-behind_ns // round(step * self._period_ns))
        found = seq + step + int(groups) * step
        return found if self.due_ns(found) >= now_ns else found + step
