"""Handling of Ctrl-C, SIGTERM and a closed terminal: each ends a command quietly, at any time.

While the command line loads, a signal ends the process at once. Afterwards an exception ends the
command (`raising`), unless the command polls for signals itself (`Interruption`).
"""

import _thread
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

LAST_RESORT_S = 30.0  # for cleaning up, after that the kernel ends the process
# until an exception that Python dropped is raised again: the hook that was told of it has to end
# before, also on a slow machine, or it is dropped once more
AGAIN_S = 0.1
_raised = False  # whether a signal has raised its exception in this process (`raising`)
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # SIGHUP does not exist on every system
Handler = Callable[[int, FrameType | None], Any]


class Interrupted(BaseException):
    """Aborts work that takes too long; an operator's `except Exception` does not catch it."""


class Stopped(KeyboardInterrupt):
    """Ctrl-C. A class of its own, so that the exit status is ours.

    Where a bare `KeyboardInterrupt` passes through `exec` of a text, as in a dataclass, `python -m`
    ends by the signal later, although the exception was caught.
    """


def quit_at_once() -> None:
    """Make signals end this process silently, while there is nothing to clean up."""
    _install(lambda number, _frame: os._exit(128 + number))


@contextmanager
def raising() -> Iterator[None]:
    """Make the first signal raise `Stopped` or `SystemExit`, and ignore later ones.

    Where Python drops the exception, as in a callback of a weak reference, it is raised again a
    moment later. After `LAST_RESORT_S` the kernel ends the process.
    """
    raised: BaseException | None = None
    status = 0
    again = False

    def note(number: int, _frame: FrameType | None) -> None:
        nonlocal raised, status, again
        global _raised
        if raised is None:
            _raised = True
            status = 128 + number
            raised = Stopped() if number == signal.SIGINT else SystemExit(status)
            end_by_kernel(LAST_RESORT_S)
        elif not again:
            return
        again = False
        raise raised

    def dropped(unraisable: "sys.UnraisableHookArgs") -> None:
        nonlocal again
        found = unraisable.exc_value
        if raised is None or raised not in (found, getattr(found, "__cause__", None)):
            show(unraisable)
            return
        again = True
        # not by SIGALRM, which the kernel keeps for the end
        timer = threading.Timer(AGAIN_S, _thread.interrupt_main, (status - 128,))
        timer.daemon = True
        timer.start()

    before, show = _install(note), sys.unraisablehook
    sys.unraisablehook = dropped
    try:
        yield
    except (RuntimeError, ImportError) as error:
        # Python 3.11 wraps what a `__set_name__` raises, so also this in the import of a class; a
        # module in C that is interrupted raises an ImportError of its own
        if raised is not None and (isinstance(error, ImportError) or error.__cause__ is raised):
            sys.exit(status)
        raise
    finally:
        sys.unraisablehook = show
        if raised is None:
            _restore(before, note)
        else:
            ignore()


def raised_one() -> bool:
    """Whether a signal has raised its exception here: the command is about to end."""
    return _raised


def ignore() -> None:
    """Ignore signals from now on: the process is about to end."""
    _install(signal.SIG_IGN)


def end_by_kernel(seconds: float) -> None:
    """Have the kernel end this process after that time; main thread only."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, seconds)


class Interruption:
    """A context that counts signals instead of raising.

    With `last`, once there was a signal, later ones are ignored after the context as well, because
    the process is about to end.
    """

    def __init__(self, *, last: bool = False) -> None:
        self._last = last
        self.count = 0
        self.number = 0  # the first signal
        self.on_signal: Callable[[], None] = lambda: None
        self._timeout_s = 0.0  # for the work that may be aborted; 0: none may
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
        """The exit status for the signal, 0 without one."""
        return 128 + self.number if self.number else 0

    def asked(self) -> int:
        """The number of signals so far."""
        return self.count

    @contextmanager
    def giving_up(self, timeout_s: float) -> Iterator[None]:
        """Abort the work in this context that long after a signal, or at the second signal.

        Cleaning up may take as long again, then the kernel ends the process.
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
    """Install a handler and return the former ones; an ignored SIGHUP (nohup) stays ignored."""
    before = {}
    for name in _NAMES:
        number = getattr(signal, name, None)
        if number is None or (name == "SIGHUP" and signal.getsignal(number) == signal.SIG_IGN):
            continue
        before[int(number)] = signal.signal(number, handler)
    return before


def _restore(before: dict[int, Any], handler: Handler) -> None:
    """Restore the former handlers, except for signals that got another one meanwhile."""
    for number, earlier in before.items():
        if signal.getsignal(number) == handler:
            signal.signal(number, earlier)
