"""Ctrl-C, SIGTERM and a closed terminal: each ends a command quietly, at any moment.

While the command line loads, a signal ends the process at once. A command is then ended by an
exception (`Raising`), unless it looks for itself whether it was asked to end (`Interruption`).
"""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

LAST_RESORT_S = 30.0  # to close what is open, after that the kernel ends the process
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # not every system has the last
Handler = Callable[[int, FrameType | None], Any]


class Interrupted(BaseException):
    """Work that takes too long is given up; no operator's `except Exception` stops it."""


def quit_at_once() -> None:
    """Have signals end this process without a word, for as long as nothing is open."""
    _install(lambda number, _frame: os._exit(128 + number))


@contextmanager
def raising() -> Iterator[None]:
    """Have the first signal raise `KeyboardInterrupt` or `SystemExit`; later ones change nothing.

    What does not end within `LAST_RESORT_S` is ended by the kernel.
    """
    asked = 0

    def note(number: int, _frame: FrameType | None) -> None:
        nonlocal asked
        asked += 1
        if asked > 1:
            return
        end_by_kernel(LAST_RESORT_S)
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        sys.exit(128 + number)

    before = _install(note)
    try:
        yield
    finally:
        if asked:
            ignore()
        else:
            _restore(before, note)


def ignore() -> None:
    """Have signals change nothing any more: this process ends as it is."""
    _install(signal.SIG_IGN)


def end_by_kernel(seconds: float) -> None:
    """Have the kernel end this process unless it has ended by then; main thread only."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, seconds)


class Interruption:
    """How often the process was asked to end. Use it as a context; nothing is raised in it.

    After the `last` one, where there was a signal, more of them change nothing: the process ends.
    """

    def __init__(self, *, last: bool = False) -> None:
        self._last = last
        self.count = 0
        self.number = 0  # the first signal
        self.on_signal: Callable[[], None] = lambda: None
        self._timeout_s = 0.0  # of the work that may be given up, 0: none may
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Interruption":
        self._before = _install(self._note)
        return self

    def __exit__(self, *_: object) -> None:
        if self._last and self.count:
            ignore()
            end_by_kernel(LAST_RESORT_S)
        else:
            _restore(self._before, self._note)

    @property
    def status(self) -> int:
        """The exit status that tells of the signal, 0 without one."""
        return 128 + self.number if self.number else 0

    def asked(self) -> int:
        """How often the process was asked to end."""
        return self.count

    @contextmanager
    def giving_up(self, timeout_s: float) -> Iterator[None]:
        """Leave the work in this context that long after a signal, or at the second one.

        What is closed on the way out has as long again, then the kernel ends the process.
        """
        self._timeout_s = timeout_s
        before = signal.signal(signal.SIGALRM, self._give_up)
        try:
            with contextlib.suppress(Interrupted):
                if self.count:
                    signal.setitimer(signal.ITIMER_REAL, timeout_s)
                yield
        finally:
            self._timeout_s = 0.0
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.count += 1
        self.number = self.number or number
        self.on_signal()
        if self._timeout_s and self.count > 1:
            self._give_up(number, None)
        elif self._timeout_s:
            signal.setitimer(signal.ITIMER_REAL, self._timeout_s)

    def _give_up(self, _number: int, _frame: FrameType | None) -> None:
        if self._timeout_s:
            end_by_kernel(self._timeout_s)
            self._timeout_s = 0.0
            raise Interrupted


def _install(handler: Handler | signal.Handlers) -> dict[int, Any]:
    """Handle the signals, return how they were handled; a hang-up that is ignored (nohup) stays."""
    before = {}
    for name in _NAMES:
        number = getattr(signal, name, None)
        if number is None or (name == "SIGHUP" and signal.getsignal(number) == signal.SIG_IGN):
            continue
        before[int(number)] = signal.signal(number, handler)
    return before


def _restore(before: dict[int, Any], handler: Handler) -> None:
    """Handle signals as before, but for those that were given another handler meanwhile."""
    for number, earlier in before.items():
        if signal.getsignal(number) == handler:
            signal.signal(number, earlier)
