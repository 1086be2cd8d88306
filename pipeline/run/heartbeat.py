"""A file that shows a watchdog outside that this process works; renewed once a second.

Its time says whether the process is alive, its text whether everything in it runs. Container
engines test both without starting an interpreter.
"""

import contextlib
import logging
import os
import time
from pathlib import Path

from pipeline.whole_file import write_whole

EVERY_S = 1.0
WORKS, STARTS = "running", "starting"  # the text: all runs; something starts, again or at first
log = logging.getLogger(__name__)


class Heartbeat:
    """The file of one process; without a path there is none. One thread calls it.

    Leaving its context removes the file.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._at_s = 0.0
        self._said = ""
        self._complained = False

    def __enter__(self) -> "Heartbeat":
        return self

    def __exit__(self, *_: object) -> None:
        if self._path is not None and self._said:
            with contextlib.suppress(OSError):
                self._path.unlink()

    def beat(self, *, works: bool) -> None:
        """Renew the file, at most once a second unless its text changes."""
        now_s, text = time.monotonic(), WORKS if works else STARTS
        if self._path is None or (text == self._said and now_s - self._at_s < EVERY_S):
            return
        self._at_s = now_s
        try:
            self._renew(self._path, text)
            self._complained = False
        except OSError as error:  # e.g. a folder that is gone: the graph goes on
            if not self._complained:
                log.error("%s: cannot be written: %s", self._path, error.strerror)
            self._complained = True

    def _renew(self, path: Path, text: str) -> None:
        if text == self._said:
            with contextlib.suppress(OSError):
                os.utime(path, follow_symlinks=False)  # works on a full disk, and wears none
                return
        write_whole(path, f"{text}\n")
        self._said = text
