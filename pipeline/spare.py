"""One process that has imported every operator and waits: a restart is then a load."""

import subprocess
import time
from collections.abc import Callable, Collection

from pipeline.child import close_pipes

YOUNG_S = 2.0  # a younger spare is still importing
END_S = 4.0


class Spare:
    """At most one process without an assignment."""

    def __init__(self, spawn: Callable[[Collection[str]], "subprocess.Popen[bytes]"]) -> None:
        self._spawn = spawn
        self._popen: subprocess.Popen[bytes] | None = None
        self._since_s = 0.0

    def keep(self, modules: Collection[str]) -> None:
        """See that there is one."""
        if self._popen is not None and self._popen.poll() is not None:
            close_pipes(self._popen)
            self._popen = None
        if self._popen is None:
            self._popen = self._spawn(sorted(modules))
            self._since_s = time.monotonic()

    def take(self) -> "subprocess.Popen[bytes] | None":
        """The spare, if it is through with its imports by all likelihood."""
        if self._popen is None or time.monotonic() - self._since_s < YOUNG_S:
            return None
        spare, self._popen = self._popen, None
        return spare

    def dismiss(self) -> None:
        """End it; what it has imported may be out of date."""
        if self._popen is None:
            return
        close_pipes(self._popen)
        try:
            self._popen.wait(END_S)
        except subprocess.TimeoutExpired:
            self._popen.kill()
            self._popen.wait()
        self._popen = None
