"""A small source with truth for tests: a white square crosses a textured field."""

import threading
import time

import numpy as np
from numpy.typing import NDArray

from drivers.source import Annotations

SIDE_PX = 8
SPEED_PX = 5  # per frame


class MovingSquare:
    """Frame k shows the square k * SPEED_PX further right; `slow_s` is the time a picture takes."""

    open_sources = 0

    def __init__(
        self,
        *,
        size_px: tuple[int, int] = (320, 192),
        rate_hz: float = 100.0,
        seed: int = 0,
        length: int | None = 40,
        slow_s: float = 0.0,
    ) -> None:
        width, height = size_px
        self.size_px, self.rate_hz, self.length, self._slow_s = size_px, rate_hz, length, slow_s
        self._field = np.random.default_rng(seed).integers(0, 200, (height, width, 3), np.uint8)
        self._buffer = np.empty_like(self._field)
        self.threads: set[int] = set()
        self.made: list[int] = []
        MovingSquare.open_sources += 1

    def picture(self, index: int) -> NDArray[np.uint8]:
        if self.length is not None and not 0 <= index < self.length:
            raise IndexError(f"no frame {index}")
        self.threads.add(threading.get_ident())
        self.made.append(index)
        time.sleep(self._slow_s)
        np.copyto(self._buffer, self._field)
        left, top, right, bottom = (int(v) for v in self.box(index))
        self._buffer[top:bottom, left:right] = 255
        return self._buffer

    def truth(self, index: int) -> Annotations | None:
        return Annotations(
            boxes=self.box(index)[None],
            ids=np.array([1], np.int32),
            labels=("ball",),
            visibility=np.ones(1, np.float32),
        )

    def box(self, index: int) -> NDArray[np.float32]:
        left = index * SPEED_PX % (self.size_px[0] - SIDE_PX)
        top = self.size_px[1] // 2
        return np.array([left, top, left + SIDE_PX, top + SIDE_PX], np.float32)

    def close(self) -> None:
        MovingSquare.open_sources -= 1


class Unreadable(MovingSquare):
    """A source whose frame 3 cannot be read."""

    def picture(self, index: int) -> NDArray[np.uint8]:
        from pipeline.errors import DriverError

        if index == 3:
            raise DriverError("somewhere: frame 3 cannot be read")
        return super().picture(index)


class EndsEarly(MovingSquare):
    """A source with fewer frames than its length."""

    def picture(self, index: int) -> NDArray[np.uint8]:
        if index >= 5:
            raise IndexError("no more")
        return super().picture(index)
