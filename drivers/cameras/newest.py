"""Keep the newest frame of a camera: a thread reads its connection and reopens a lost one.

The thread decodes into one of three pictures: the one that the reader looks at, the newest one that
was not read yet, and one to write into. A frame that is replaced before it was read is counted.
"""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from drivers.camera import Picture
from drivers.cameras.history import LinkHistory
from drivers.cameras.link import LinkSettings
from pipeline.errors import DriverError

WAIT_S = 0.2  # longest wait of a connection that can be asked to wait
CLOSE_S = 1.0  # on top of the connection's own limits
DIAGNOSIS_S = 3.0  # to find out why it cannot be opened
log = logging.getLogger(__name__)


class Connection(Protocol):
    """One opening of a camera; used by one thread."""

    def wait(self, timeout_s: float) -> bool:
        """Wait for a frame; False: none yet. Raises `DriverError` when no more will come.

        A connection that cannot be interrupted may wait as long as the link's `read_timeout_s`.
        """
        ...

    def decode(self, into: NDArray[Any] | None) -> NDArray[Any] | None:
        """The frame that was waited for, in `into` if that fits; None: it is damaged or empty."""
        ...

    def close(self) -> None:
        """Release the device."""
        ...


class Mismatch(DriverError):
    """The camera's frames are no longer what was negotiated: to reopen it does not help."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Frame:
    pixels: NDArray[Any]
    stamp_ns: int


class NewestFrame:
    """`open read* close`; `read` and `close` may be called by different threads."""

    def __init__(
        self, connect: Callable[[], Connection], limits: LinkSettings, *, name: str
    ) -> None:
        self._connect, self._limits, self._name = connect, limits, name
        self._changed = threading.Condition()
        self._ending = threading.Event()  # tells the thread
        self._open = False
        self._thread: threading.Thread | None = None
        self._newest: _Frame | None = None
        self._held: NDArray[Any] | None = None  # what the reader looks at
        self._spare: list[NDArray[Any]] = []
        self._shape: tuple[tuple[int, ...], Any] | None = None  # and dtype, of all frames
        self._skipped = 0  # since the last read
        self._last_ns = 0  # stamp of the newest frame ever
        self._connected = False  # this connection has brought a frame
        self._failures = 0  # attempts in a row that brought none
        self._failure: DriverError | None = None
        self._cause = self._reason = ""  # why it was lost, and why the last attempt failed
        self.history = LinkHistory()

    @property
    def absent_until_s(self) -> float:
        """Until when it looks for a lost camera, in `time.monotonic()`; 0: none is lost."""
        lost = self._open and not self._connected and self._last_ns
        return self._last_ns / 1e9 + self._limits.outage_s if lost else 0.0

    def open(self) -> NDArray[Any]:
        """Start the thread and return the first frame, which stays to be read.

        Raises `DriverError` with the reason when there is none within the limits.
        """
        limits, self._open = self._limits, True
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        one_s = limits.open_timeout_s + limits.read_timeout_s + CLOSE_S + DIAGNOSIS_S
        allowed_s = limits.open_wait_s + one_s
        with self._changed:
            self._changed.wait_for(
                lambda: self._newest or self._failure or not self._open, allowed_s
            )
            if self._newest is not None:
                return self._newest.pixels
            if self._failure is not None:
                raise self._failure
            self._ending.set()
            if not self._open:
                raise DriverError(f"{self._name}: closed before its first frame")
            reason = self._reason or "it does not answer"
            raise DriverError(f"{self._name}: no frame within {allowed_s:g} s: {reason}")

    def read(self, timeout_s: float) -> Picture | None:
        """The newest frame that was not read yet; None: none in time, or closed."""
        deadline_s = time.monotonic() + timeout_s
        with self._changed:
            while True:
                if not self._open:
                    return None
                if self._newest is not None:
                    return self._hand_out(self._newest)
                if self._failure is not None:
                    raise self._failure
                lost_s = (time.monotonic_ns() - self._last_ns) / 1e9
                if lost_s > self._limits.outage_s:
                    raise self._give_up(lost_s)
                left_s = deadline_s - time.monotonic()
                if left_s <= 0:
                    return None
                self._changed.wait(min(left_s, max(0.001, self._limits.outage_s - lost_s)))

    def close(self) -> None:
        """End the thread, which may be waiting for the device as long as its limits allow."""
        with self._changed:
            self._open = False
            self._ending.set()
            self._changed.notify_all()
        if self._thread is not None:
            limits = self._limits
            self._thread.join(max(limits.open_timeout_s, limits.read_timeout_s) + CLOSE_S)
            if self._thread.is_alive():
                log.warning("%s: it does not return; its thread is left behind", self._name)
            self._thread = None
        with self._changed:
            self._newest = self._held = None
            self._spare = []

    def _hand_out(self, frame: _Frame) -> Picture:
        if self._held is not None:
            self._spare.append(self._held)
        skipped, self._skipped = self._skipped, 0
        self._held, self._newest = frame.pixels, None
        self.history.delivered += 1
        return Picture(pixels=frame.pixels, stamp_ns=frame.stamp_ns, skipped=skipped)

    def _give_up(self, lost_s: float) -> DriverError:
        self._ending.set()
        reason = f": {self._reason}" if self._reason else ""
        self.history.outage(round(lost_s * 1e9), attempts=self._failures, reason=self._cause)
        self._failure = DriverError(
            f"{self._name}: no frame for {lost_s:.1f} s, more than outage_s, "
            f"{self._limits.outage_s:g}{reason}"
        )
        return self._failure

    def _run(self) -> None:
        try:
            self._keep_connected()
        except Mismatch as error:
            self._fail(error)
        except Exception as error:  # raised again where it can be handled, in `read`
            broke = DriverError(f"{self._name}: reading it broke: {type(error).__name__}")
            broke.__cause__ = error
            self._fail(broke)

    def _keep_connected(self) -> None:
        """Open the camera and read it, again and again until it is closed."""
        begun_s = time.monotonic()
        while not self._ending.is_set():
            self._connected = False
            try:
                self._read_one_connection(self._failures + 1)
            except Mismatch:
                raise
            except DriverError as error:
                self._lost(error)
                waited_s = time.monotonic() - begun_s
                if not self._last_ns and waited_s >= self._limits.open_wait_s:
                    self._fail(error)
                    return
            self._failures = 0 if self._connected else self._failures + 1
            self._ending.wait(self._limits.pause_s(self._failures))

    def _read_one_connection(self, attempts: int) -> None:
        """Read frames until the connection is lost, which raises `DriverError`, or closed."""
        self.history.attempts += 1
        connection = self._connect()
        try:
            damaged, before_ns = 0, 0
            until_s = time.monotonic() + self._limits.open_timeout_s
            while not self._ending.is_set():
                if connection.wait(WAIT_S):
                    stamp_ns = time.monotonic_ns()
                    if self._take(connection, stamp_ns, before_ns, attempts):
                        until_s = time.monotonic() + self._limits.read_timeout_s
                        damaged = 0
                    else:
                        damaged += 1
                    before_ns = stamp_ns
                if time.monotonic() > until_s:
                    sent = f"only damaged frames, {damaged} of them" if damaged else "no frame"
                    raise DriverError(f"{self._name}: it is open but sends {sent}")
        finally:
            connection.close()

    def _take(self, connection: Connection, stamp_ns: int, before_ns: int, attempts: int) -> bool:
        """Decode a frame and make it the newest; False: it is damaged."""
        with self._changed:
            into = self._spare.pop() if self._spare else None
        pixels = connection.decode(into)
        with self._changed:
            self.history.arrived(stamp_ns, before_ns)
            if pixels is None:
                self.history.damaged += 1
                self._skipped += 1
                if into is not None:
                    self._spare.append(into)
                return False
            self._check(pixels)
            if not self._connected and self._last_ns:
                self._back(stamp_ns, attempts)
            if self._newest is not None:
                self._spare.append(self._newest.pixels)
                self.history.unread += 1
                self._skipped += 1
            self._newest = _Frame(pixels=pixels, stamp_ns=stamp_ns)
            self._last_ns, self._connected = stamp_ns, True
            self._changed.notify_all()
        return True

    def _check(self, pixels: NDArray[Any]) -> None:
        found = (pixels.shape, pixels.dtype)
        if self._shape is None:
            self._shape = found
        if found != self._shape:
            raise Mismatch(
                f"{self._name}: expected frames of {_by(self._shape[0])} as at the start, got "
                f"{_by(pixels.shape)}: open it again"
            )

    def _back(self, stamp_ns: int, attempts: int) -> None:
        lasted_ns = stamp_ns - self._last_ns
        self.history.reconnects += 1
        self.history.outage(lasted_ns, attempts=attempts, reason=self._cause)
        tries = f"{attempts} {'attempt' if attempts == 1 else 'attempts'}"
        log.warning("%s: back after %.1f s and %s", self._name, lasted_ns / 1e9, tries)

    def _lost(self, error: DriverError) -> None:
        with self._changed:
            self._reason = str(error).removeprefix(f"{self._name}: ")
            if self._connected:
                self._cause = self._reason
        if self._connected and not self._ending.is_set():
            log.warning("%s: lost, reconnecting: %s", self._name, self._reason)

    def _fail(self, error: DriverError) -> None:
        with self._changed:
            self._failure = error
            self._changed.notify_all()


def _by(shape: tuple[int, ...]) -> str:
    return "x".join(str(side) for side in shape[1::-1])
