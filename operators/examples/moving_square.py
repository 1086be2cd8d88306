"""A source: nothing in, one grey frame per exposure out, with a moving bright square.

fovea run examples/moving_square --frames 100
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

import numpy as np
from fovea import Frame, Header, SettingsError, Source


@dataclass(frozen=True, kw_only=True)
class MovingSquareSettings:
    """What a graph may set."""

    rate_hz: float = 30.0
    side_px: int = 128  # of the picture
    square_px: int = 16
    step_px: int = 2  # from frame to frame
    length: int = 0  # frames until the stream ends, 0: it never does

    def __post_init__(self) -> None:
        if self.rate_hz <= 0:
            raise SettingsError(f"rate_hz: must be positive, got {self.rate_hz}")
        if not 0 < self.square_px < self.side_px:
            what = f"must be at least 1 and less than side_px ({self.side_px})"
            raise SettingsError(f"square_px: {what}, got {self.square_px}")
        for name in ("step_px", "length"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must be at least 0, got {getattr(self, name)}")


class MovingSquare(Source[MovingSquareSettings, Frame]):
    """The square moves from left to right, repeatedly. Without a device, `open` starts a clock."""

    def open(self) -> None:
        """Begin a new stream; its new id makes the rest of the graph forget the former one."""
        self._stream, self._seq = uuid4().hex, 0
        self._began_s = self._newest_s = time.monotonic()

    def produce(self) -> dict[str, Frame] | None:
        """Return the next exposure, one message per output; None at the end of the stream."""
        settings, seq = self.settings, self._seq
        if settings.length and seq >= settings.length:
            return None
        if self.realtime:  # in lockstep, the runner requests each frame
            due_s = self._began_s + seq / settings.rate_hz
            time.sleep(max(0.0, due_s - time.monotonic()))
        self._seq, self._newest_s = seq + 1, time.monotonic()
        side = settings.side_px
        pixels = self.loan((side, side, 3), np.uint8)  # shared memory: sending it copies nothing
        pixels[...] = 40
        left = seq * settings.step_px % (side - settings.square_px)
        top = (side - settings.square_px) // 2
        pixels[top : top + settings.square_px, left : left + settings.square_px] = 200
        header = Header(stream=self._stream, seq=seq, stamp_ns=time.monotonic_ns())
        return {"out": Frame(header=header, pixels=pixels, window=(0, 0, side, side))}

    def summary(self) -> Mapping[str, Any]:
        """Return target and achieved rate, by which the report judges the run."""
        took_s = self._newest_s - self._began_s  # one interval fewer than frames
        achieved_hz = (self._seq - 1) / took_s if took_s > 0 else 0.0
        rate = {"asked_hz": self.settings.rate_hz, "achieved_hz": round(achieved_hz, 2)}
        return {"rate": rate} if self.realtime and self._seq > 1 else {}
