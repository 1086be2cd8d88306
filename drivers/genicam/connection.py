"""A device that may be lost: opened once by its user, and again with back-off by a thread."""

import logging
import threading
import time
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from pipeline.errors import DriverError, FoveaError
from pipeline.text import error_text, harmless

FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 2.0
CLOSE_S = 0.5  # to close what was lost, before the first attempt to open it again

log = logging.getLogger(__name__)


class Closable(Protocol):
    """What a connection holds."""

    def close(self) -> None:
        """Release it; safe after any outcome."""
        ...


T = TypeVar("T", bound=Closable)


class Connection(Generic[T]):
    """Holds what `make` opens. `held` may be called by one thread, `close` by another."""

    def __init__(self, name: str, make: Callable[[], T], *, absent_s: float) -> None:
        self._name, self._make, self._absent_s = name, make, absent_s
        self._changed = threading.Condition()
        self._held: T | None = None
        self._failed = ""
        self._closed = False
        self._worker: threading.Thread | None = None
        self.losses = 0
        self.absent_until_s = 0.0  # until when what was lost is opened again; 0: nothing is lost

    @property
    def alive(self) -> bool:
        """Whether something is open now."""
        return self._held is not None and not self._closed

    def open(self) -> T:
        """Open it for the first time; raises what `make` raises."""
        self._held = held = self._make()
        self._closed, self._failed = False, ""
        return held

    def held(self, timeout_s: float) -> T | None:
        """What is open; None: nothing in time, or closed. Raises `DriverError` if it stays away."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._held is not None or self._closed or bool(self._failed),
                timeout=max(timeout_s, 0),
            )
            if self._failed:
                raise DriverError(self._failed)
            return None if self._closed else self._held

    def lose(self, why: str) -> None:
        """Release what does not answer any more, and begin to open it again."""
        with self._changed:
            held, self._held = self._held, None
            if held is None or self._closed:
                return
            self.losses += 1
            self.absent_until_s = time.monotonic() + self._absent_s
        log.warning("%s: lost: %s", self._name, why)
        self._worker = threading.Thread(
            target=self._reopen, args=(held, why), name="reconnect", daemon=True
        )
        self._worker.start()

    def close(self) -> None:
        """Release it and end the thread, whose present attempt is finished first."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            worker = self._worker
        if worker is not None:
            worker.join()
        held, self._held = self._held, None
        if held is not None:
            held.close()

    def _reopen(self, lost: T, why: str) -> None:
        began_s, wait_s = time.monotonic(), FIRST_WAIT_S
        # a USB device is free once it is closed, at once; GigE waits for answers that do not come
        closing = threading.Thread(target=lost.close, name="closing", daemon=True)
        closing.start()
        closing.join(CLOSE_S)
        while not self._pause(wait_s):
            try:
                held = self._make()
            except FoveaError as error:
                why = str(error)
            except Exception as error:  # raised again where it can be handled, in `held`
                self._fail(f"{self._name}: opening it again broke: {harmless(error_text(error))}")
                return
            else:
                log.info("%s: back after %.1f s", self._name, time.monotonic() - began_s)
                self._set(held)
                return
            if time.monotonic() - began_s > self._absent_s:
                self._fail(
                    f"{self._name}: expected it back within {self._absent_s:g} s, got: {why}"
                )
                return
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    def _pause(self, wait_s: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._closed, timeout=wait_s)

    def _set(self, held: T) -> None:
        with self._changed:
            self._held, self.absent_until_s = held, 0.0
            self._changed.notify_all()

    def _fail(self, sentence: str) -> None:
        with self._changed:
            self._failed = sentence
            self._changed.notify_all()
