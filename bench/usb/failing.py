"""A virtual board that knows what it exposed and when it failed, and the driver above it."""

import time
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.usb.reasons import Loss, NotedLosses
from drivers.usb import DualStreamBoard
from drivers.usb.frame_header import Stream, Window
from drivers.virtual_board.backend import VirtualBackend, VirtualBoardSettings
from drivers.virtual_board.board import VirtualBoard
from drivers.virtual_board.exposures import Exposed
from drivers.virtual_board.faults import Fault, FaultScript
from drivers.virtual_board.world import World
from pipeline.errors import DriverError
from pipeline.pixel_formats import FORMATS

FORM = FORMATS["rgb8"]
LEVELS = 251  # grey levels in turn; a prime, so that no power of two hides a mistake


class FlatWorld(World):
    """Every picture has one level, which tells the exposure."""

    def __init__(self) -> None:
        self.length = None

    def code(self, window: Window, size_px: tuple[int, int]) -> int:
        """PFNC code of every picture."""
        return FORM.code

    def payload(
        self, index: int, window: Window, size_px: tuple[int, int], nbytes: int, port: int
    ) -> NDArray[np.uint8]:
        """Return bytes of the exposure's level."""
        return np.full(nbytes, level_of(index), np.uint8)

    def close(self) -> None:
        """Nothing is held open."""


def level_of(exposure: int) -> int:
    """Return the level of every sample of an exposure."""
    return exposure % LEVELS


class _Noted(deque[Exposed]):
    """Frames that wait for the host; notes each that was ever among them."""

    def __init__(self, seen: set[int]) -> None:
        super().__init__()
        self._seen = seen

    def append(self, one: Exposed, /) -> None:
        self._seen.add(one.exposure)
        super().append(one)


class _Script(FaultScript):
    """Notes when each failure happened, and at which exposure."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        super().__init__(faults)
        self.times: list[tuple[float, int]] = []  # on the monotonic clock; exposure

    def due(self, kind: Any, exposure: int, stream: str = "") -> Fault | None:
        found = super().due(kind, exposure, stream)
        if found is not None:
            self.times.append((time.monotonic(), exposure))
        return found


class WitnessedBoard(VirtualBoard):
    """`exposed` has the exposures of each START, `script.times` the failures."""

    def __init__(self, settings: VirtualBoardSettings, faults: Iterable[Fault]) -> None:
        super().__init__(settings.scaled(), lambda _code, _most_px: FlatWorld())
        self.faults = self.script = _Script(faults)
        self.exposed: list[set[int]] = []

    def _start(self, *, triggered: bool) -> None:
        super()._start(triggered=triggered)
        self.exposed.append(set())
        running = self._running()
        running.waiting = {stream: _Noted(self.exposed[-1]) for stream in Stream}


class WitnessedBackend(VirtualBackend):
    """A witnessed board as a backend of pyusb."""

    def __init__(self, settings: VirtualBoardSettings) -> None:
        faults = [Fault(**one) for one in settings.faults]
        self.witnessed = WitnessedBoard(settings, faults)
        super().__init__(settings, board=self.witnessed)


class WitnessedDriver(DualStreamBoard):
    """The driver, and the board behind its link."""

    def open(self, *, realtime: bool) -> None:
        """Acquire the board, and note every loss from now on."""
        super().open(realtime=realtime)
        self._opened().losses = self._losses = NotedLosses()  # before `start` makes a receiver

    @property
    def noted(self) -> list[Loss]:
        """The losses that the driver has counted, in order."""
        return self._losses.noted

    @property
    def board(self) -> WitnessedBoard:
        """The board; only while it is open."""
        backend = self._opened()._backend  # the link is where the two meet
        if not isinstance(backend, WitnessedBackend):
            raise DriverError(f"usb: expected a WitnessedBackend, got {type(backend).__name__}")
        return backend.witnessed

    @property
    def first_seq(self) -> int:
        """The seq of exposure 0 since the newest START."""
        return self._opened().first_seq
