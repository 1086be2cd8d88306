"""Programs of their own for what may hang or crash: JSON objects out, one a line.

A library that ends its process or never returns takes neither `fovea sensors` nor the search for
another kind along. `python -m drivers.attached.child MODULE:FUNCTION WORDS` calls a function with
its words; what it yields is printed, and what libraries print goes to standard error.
"""

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from pipeline import errors
from pipeline.errors import DriverError, FoveaError, InstallError
from pipeline.import_path import imported
from pipeline.text import error_text, harmless, said_by
from pipeline.user_modules import interpreter_options, look_in

MOST_BYTES = 1 << 20  # of one object
PIECE_BYTES = 1 << 16
POLL_S = 0.02  # while it ends
GRACE_S = 5  # of an orphan beyond the limit of its parent
ENDED = "ended"  # key of the last object, which tells that nothing is missing
FAILED, FAMILY = "failed", "family"  # keys of an error: its sentence and its class in errors.py
Yields = Callable[..., Iterable[Mapping[str, Any]]]


class Child:
    """A running child; use it as a context, which ends it and all that it started."""

    def __init__(
        self, path: str, *words: str, limit_s: float, in_all: bool = False, quiet: bool = False
    ) -> None:
        """`limit_s` is the longest wait for each object, or for all of them: `in_all`.

        `quiet`: discard what it prints.
        """
        child = [sys.executable, *interpreter_options(), "-m", "drivers.attached.child"]
        command = [*child, path, f"{limit_s:g}", *words]
        self._limit_s, self._in_all = limit_s, in_all
        self._begun_s = time.monotonic()
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None,
            start_new_session=True,
        )
        self._rest = b""

    def __enter__(self) -> "Child":
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def next(self) -> dict[str, Any] | None:
        """Return the next object; None after the last one.

        Raises `DriverError` when it takes longer than the limit, counted from the one before or,
        `in_all`, from the start, and when the child ends early.
        """
        deadline_s = self._begun_s + self._limit_s
        while b"\n" not in self._rest:
            piece = self._piece(deadline_s)
            if not piece:
                raise DriverError(self._end())
            self._rest += piece
            if len(self._rest) > MOST_BYTES:
                raise DriverError(f"expected answers of at most {MOST_BYTES} bytes, got more")
        line, _, self._rest = self._rest.partition(b"\n")
        if not self._in_all:
            self._begun_s = time.monotonic()
        found: dict[str, Any] = json.loads(line)
        return None if ENDED in found else found

    def _piece(self, deadline_s: float) -> bytes:
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        with selectors.DefaultSelector() as waiting:
            waiting.register(descriptor, selectors.EVENT_READ)
            left_s = max(deadline_s - time.monotonic(), 0)
            if not waiting.select(left_s):
                raise DriverError(f"no answer within {self._limit_s:g} s")
        return os.read(descriptor, PIECE_BYTES)

    def _end(self) -> str:
        """Say how it ended. It is not reaped yet: its number is still that of its group."""
        deadline_s = time.monotonic() + GRACE_S
        how = os.WEXITED | os.WNOWAIT | os.WNOHANG
        while (ended := os.waitid(os.P_PID, self._process.pid, how)) is None:
            if time.monotonic() > deadline_s:
                return "it closed its output before it was done"
            time.sleep(POLL_S)
        if ended.si_code == os.CLD_EXITED:
            return f"it ended early, with exit status {ended.si_status}"
        return f"the library crashed ({signal.Signals(ended.si_status).name})"


def main(path: str, limit_s: str, *words: str) -> None:
    """Call a function and print what it yields; an error is the last object."""
    told = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    look_in()  # drivers of the user are in the current folder

    def tell(found: Mapping[str, Any]) -> None:
        told.write(json.dumps(found) + "\n")
        told.flush()
        signal.alarm(round(float(limit_s)) + GRACE_S)  # should the parent be killed meanwhile

    signal.alarm(round(float(limit_s)) + GRACE_S)
    try:
        found: Yields = imported(path, InstallError)
        for item in found(*words):
            tell(item)
    except FoveaError as error:
        why = said_by(error).removeprefix(f"{path} cannot be imported: ")
        tell({FAILED: harmless(why), FAMILY: _family(error)})
    except Exception as error:
        tell({FAILED: harmless(error_text(error)), FAMILY: DriverError.__name__})
    tell({ENDED: True})
    os._exit(0)  # threads of libraries may keep the interpreter waiting


def _family(error: FoveaError) -> str:
    """Return the name of the nearest class of the error that `pipeline.errors` declares."""
    return next(c.__name__ for c in type(error).__mro__ if c.__module__ == errors.__name__)


if __name__ == "__main__":
    main(*sys.argv[1:])
