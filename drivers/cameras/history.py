"""What happened on the link to a camera: frames, outages and attempts, as figures."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

MOST_OUTAGES = 16  # told one by one; all of them are counted


@dataclass(kw_only=True)
class LinkHistory:
    """Counted by one thread; frames = delivered + unread + damaged + at most one that waits."""

    frames: int = 0  # that arrived
    delivered: int = 0
    unread: int = 0  # replaced by a newer one
    damaged: int = 0  # could not be decoded, or were empty
    attempts: int = 0  # to open the camera
    reconnects: int = 0
    connected_ns: int = 0  # time between the first and the last frame of each connection
    intervals: int = 0  # number of them
    outages: int = 0
    outage_ns: int = 0
    longest_ns: int = 0
    told: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_OUTAGES))

    def arrived(self, stamp_ns: int, last_ns: int) -> None:
        """A frame came; `last_ns` is the stamp of the one before on this connection, 0: none."""
        self.frames += 1
        if last_ns:
            self.connected_ns += stamp_ns - last_ns
            self.intervals += 1

    def outage(self, lasted_ns: int, *, attempts: int, reason: str) -> None:
        """An outage is over, or the camera was given up."""
        self.outages += 1
        self.outage_ns += lasted_ns
        self.longest_ns = max(self.longest_ns, lasted_ns)
        lasted_s = round(lasted_ns / 1e9, 3)
        self.told.append({"lasted_s": lasted_s, "attempts": attempts, "reason": reason})

    @property
    def rate_hz(self) -> float:
        """Frames per second while connected; 0: not known yet."""
        return self.intervals * 1e9 / self.connected_ns if self.connected_ns else 0.0

    def summary(self) -> dict[str, Any]:
        """The figures; `outages.newest` are at most the last sixteen."""
        return {
            "frames": {
                "arrived": self.frames,
                "delivered": self.delivered,
                "unread": self.unread,
                "damaged": self.damaged,
            },
            "attempts": self.attempts,
            "reconnects": self.reconnects,
            "outages": {
                "count": self.outages,
                "total_s": round(self.outage_ns / 1e9, 3),
                "longest_s": round(self.longest_ns / 1e9, 3),
                "newest": [dict(outage) for outage in self.told],
            },
        }
