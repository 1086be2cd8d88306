"""One process that has imported every operator and waits: a restart is then a load."""

import logging
import os
import sys
import sysconfig
import time
from collections.abc import Callable, Collection

from pipeline.run.process_handle import KILLED_S, NodeProcess

AGAIN_S = 5.0  # after one that ended by itself, or could not be had
INSTALLED = tuple(
    os.path.join(sysconfig.get_path(kind), "")
    for kind in ("stdlib", "platstdlib", "purelib", "platlib")
)
log = logging.getLogger(__name__)


class WarmSpare:
    """At most one process without an assignment."""

    def __init__(self, spawn: Callable[[Collection[str]], NodeProcess]) -> None:
        self._spawn = spawn
        self._process: NodeProcess | None = None
        self._since_s = 0.0  # wall clock, as files have it
        self._again_s = 0.0

    def keep(self, modules: Collection[str]) -> None:
        """See that there is one; without one a restart takes longer, and nothing else."""
        self._bury()
        if self._process is not None or time.monotonic() < self._again_s:
            return
        self._since_s, self._again_s = time.time(), time.monotonic() + AGAIN_S
        try:
            self._process = self._spawn(sorted(modules))
        except OSError as error:
            log.warning("no process can stand by: %s", error)

    def take(self) -> NodeProcess | None:
        """The spare, if it is through with its imports: it says so in its first line."""
        self._bury()
        if self._process is None or self.warming:
            return None
        spare, self._process, self._again_s = self._process, None, 0.0
        return spare

    @property
    def warming(self) -> bool:
        """Whether there is one that is not through."""
        return self._process is not None and not self._process.channel.waiting()

    def refresh(self) -> None:
        """End it when what it has imported was edited since."""
        if self._process is not None and edited_since(self._since_s):
            self.dismiss()

    def dismiss(self) -> None:
        """End it."""
        if self._process is None:
            return
        self._process.kill()  # it holds nothing
        if not self._process.await_end(KILLED_S):
            log.error("process %d hangs in the kernel: it is left", self._process.pid)
        self._process.bury()
        self._process, self._again_s = None, 0.0

    def _bury(self) -> None:
        if self._process is not None and self._process.ended() is not None:
            self._process.bury()
            self._process = None


def edited_since(moment_s: float) -> bool:
    """Whether a module that this process has imported, no installed one, was edited since.

    `moment_s` is a time of `time.time()`. A module that is not imported yet cannot be out of date.
    """
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if not file or file.startswith(INSTALLED):
            continue
        try:
            if os.stat(file).st_mtime > moment_s:  # a Path would intern each part of it
                return True
        except OSError:
            continue
    return False
