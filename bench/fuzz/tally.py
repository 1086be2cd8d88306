"""Outcomes of generated cases: accepted, refused or failed."""

import os
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.errors import FoveaError

LONGEST_S = 60.0  # a case that takes longer hangs
MOST_SENTENCE = 2000  # characters
KEPT = 20  # examples of failures
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
CHANGES = ("os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.link", "os.symlink")


class TooSlow(BaseException):
    """A case exceeded its time limit; not caught by `except Exception`."""


@dataclass
class Tally:
    """The figures of a run."""

    cases: int = 0
    accepted: int = 0
    refused: int = 0
    tracebacks: int = 0
    hangs: int = 0
    bad_sentences: int = 0
    slowest_ms: float = 0.0
    files_touched: int = 0
    examples: list[str] = field(default_factory=list)
    kinds: Counter[str] = field(default_factory=Counter)

    def check(
        self, case: object, act: Callable[[], Any], sentence: Callable[[str], bool] = bool
    ) -> None:
        """Run one case and count its outcome; `sentence`: whether a refusal's text is valid.

        >>> tally = Tally()
        >>> tally.check("1", lambda: 1)
        >>> tally.check("x", lambda: int("x"))
        >>> (tally.cases, tally.accepted, tally.tracebacks)
        (2, 1, 1)
        """
        self.cases += 1
        began_s = time.perf_counter()
        try:
            with bounded(LONGEST_S):
                act()
            self.accepted += 1
        except FoveaError as error:
            self.refused += 1
            said = str(error)
            if "\n" in said or len(said) > MOST_SENTENCE or not said or not sentence(said):
                self.bad_sentences += 1
                self._keep(case, f"not a sentence: {said}")
        except TooSlow:
            self.hangs += 1
            self._keep(case, "hangs")
        except BaseException as error:
            self.tracebacks += 1
            self.kinds[type(error).__name__] += 1
            self._keep(case, traceback.format_exc(limit=-4))
        self.slowest_ms = max(self.slowest_ms, 1000 * (time.perf_counter() - began_s))

    def with_touched(self, files: set[str]) -> "Tally":
        """Return this tally with the files that should not have been touched."""
        self.files_touched = len(files)
        self.examples += sorted(files)[:5]
        return self

    @property
    def sound(self) -> bool:
        """Whether there were cases and no failures."""
        wrong = self.tracebacks + self.hangs + self.bad_sentences + self.files_touched
        return self.cases > 0 and wrong == 0

    def _keep(self, case: object, what: str) -> None:
        if len(self.examples) < KEPT:
            self.examples.append(f"{str(case)[:1500]}\n=> {what}")


@contextmanager
def bounded(seconds: float) -> Iterator[None]:
    """Raise `TooSlow` in the main thread after so many seconds."""

    def stop(_number: int, _frame: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


class Watch:
    """Records which files outside some folders this process opens for writing, makes or removes.

    Relative paths are ignored, because the interpreter does not report which open folder they
    belong to; `alone` finds the files made in the working folder. Programs that are started count,
    except this Python.
    """

    def __init__(self, *folders: Path, begins: str = "") -> None:
        """`begins`: the beginning of paths of folders with random names."""
        self._folders = tuple(f"{folder.resolve()}{os.sep}" for folder in folders)
        self._folders += (begins,) if begins else ()
        self.on = False
        self.touched: set[str] = set()
        sys.addaudithook(self._hear)  # a hook cannot be removed: `on` disables it

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event == "open":
            path, _mode, flags = arguments
            if not isinstance(flags, int) or not flags & WRITES:
                return
        elif event not in CHANGES and event != "subprocess.Popen":
            return
        else:
            path = arguments[0]
        if isinstance(path, int) or path == sys.executable:
            return
        place = os.path.normpath(os.fsdecode(path) if isinstance(path, (str, bytes)) else str(path))
        own = f"{place}{os.sep}".startswith(self._folders) or place == os.devnull
        if os.path.isabs(place) and not own and "__pycache__" not in place:
            self.touched.add(f"{event} {place}")


@contextmanager
def alone(folder: Path) -> Iterator[set[str]]:
    """Work in an empty folder that is also the home; the set then holds what was made there.

    Processes that are started meanwhile inherit both.
    """
    before, home, made = Path.cwd(), os.environ.get("HOME"), set[str]()
    os.environ["HOME"] = str(folder)
    os.chdir(folder)
    try:
        yield made
    finally:
        os.chdir(before)
        if home is None:
            del os.environ["HOME"]
        else:
            os.environ["HOME"] = home
        made |= {str(path.relative_to(folder)) for path in folder.rglob("*")}
