"""A started board that sends nothing is asked how it is; a fault or a restart is noticed."""

import logging
import time
from collections import Counter

from drivers.usb.capabilities import CaptureMode
from drivers.usb.connection import Connection
from drivers.usb.errors import Unplugged
from drivers.usb.requests import Configuration, Fault, State
from pipeline.errors import DriverError

BURST_STATES = (State.RECORDING, State.DOWNLOADING)
SILENCE_S = 1.0  # without a header, beside ten frames' time; then the board is asked
SILENCES = 3  # in a row; then it is an error

log = logging.getLogger(__name__)


class Silence:
    """Watches one start of a board; `counts["silences"]` counts how often it had to be asked."""

    def __init__(
        self, connection: Connection, wanted: Configuration, exposure_bytes: int,
        counts: Counter[str],
    ) -> None:  # fmt: skip
        self._connection, self._wanted, self._counts = connection, wanted, counts
        self._exposure_bytes = exposure_bytes
        self.heard()

    def heard(self) -> None:
        """A header has come."""
        self._heard_s, self._silences, self._busy_s = time.monotonic(), 0, 0.0

    def asked(self) -> bool:
        """Return whether the board had to be asked, and goes on.

        Raises `DriverError` when it reports a fault or stays silent, `Unplugged` when it has
        restarted.
        """
        now_s = time.monotonic()
        if now_s - self._heard_s < self._limit_s():
            return False
        silent_since_s, self._heard_s = self._heard_s, now_s
        status, where = self._connection.status(), self._connection.where
        if status.fault is not Fault.NONE:
            raise DriverError(f"{where}: the board reports a fault: {status.fault.name.lower()}")
        self._busy_s += now_s - silent_since_s
        if status.state in BURST_STATES and self._busy_s < self._burst_s():
            return False
        self._counts["silences"] += 1
        self._silences += 1
        state = status.state.name.lower()
        quiet = f"{where}: no frame came for {now_s - silent_since_s:.1f} s"
        log.warning("%s; the board says that it is %s", quiet, state)
        if self._silences >= SILENCES:
            raise DriverError(f"{where}: the board sends nothing, and says that it is {state}")
        if status.state is State.IDLE:
            raise Unplugged(f"{where}: the board has restarted")
        return True

    def _limit_s(self) -> float:
        rate_mhz = self._wanted.rate_mhz
        if self._wanted.mode is CaptureMode.RECORD:
            rate_mhz = self._connection.can.preview_mhz or rate_mhz
        return SILENCE_S + 10_000 / rate_mhz

    def _burst_s(self) -> float:
        """How long a burst may take until its first frame is here."""
        can = self._connection.can
        frames = self._wanted.burst_frames or can.burst_frames
        link_s = 0.0
        if can.link_bytes_per_s:
            link_s = frames * self._exposure_bytes / can.link_bytes_per_s
        return SILENCE_S + 2 * (frames * 1000 / self._wanted.rate_mhz + link_s)
