"""A spare process that has imported every operator, which makes restarts fast."""

import logging
import time
from collections.abc import Callable, Collection, Iterable
from itertools import chain

from pipeline.module_files import edited_since, module_files
from pipeline.run.process_handle import KILLED_S, NodeProcess

AGAIN_S = 5.0  # pause after a spare that ended or could not be started
MOST_FILES = 10_000  # files watched for edits
log = logging.getLogger(__name__)


class WarmSpare:
    """At most one process without an assignment."""

    def __init__(self, spawn: Callable[[Collection[str]], NodeProcess]) -> None:
        self._spawn = spawn
        self._process: NodeProcess | None = None
        self._since_s = 0.0  # wall clock, to compare with modification times
        self._again_s = 0.0
        self._files: set[str] = set()  # imported by other processes

    def watch(self, files: Iterable[str]) -> None:
        """Watch these files, too, because this process does not import what nodes do."""
        if len(self._files) < MOST_FILES:
            self._files.update(files)

    def keep(self, modules: Collection[str]) -> None:
        """Ensure that there is a spare; without one, restarts only take longer."""
        self._bury()
        if self._process is not None or time.monotonic() < self._again_s:
            return
        self._since_s, self._again_s = time.time(), time.monotonic() + AGAIN_S
        try:
            self._process = self._spawn(sorted(modules))
        except OSError as error:
            log.warning("cannot start a spare process: %s", error)

    def take(self) -> NodeProcess | None:
        """Return the spare if it has finished its imports, which its first event announces."""
        self._bury()
        if self._process is None or self.warming:
            return None
        spare, self._process, self._again_s = self._process, None, 0.0
        return spare

    @property
    def process_id(self) -> int:
        """The pid of the spare, 0 while there is none."""
        return self._process.pid if self._process else 0

    @property
    def warming(self) -> bool:
        """Whether there is a spare that is still importing."""
        return self._process is not None and not self._process.channel.waiting()

    def refresh(self) -> None:
        """End the spare when code that it may have imported was edited since."""
        files = chain(module_files(), self._files)
        if self._process is not None and edited_since(self._since_s, files):
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
