"""Resources that a supervisor owns: the graph's name, run folder and memory folder."""

import json
import logging
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from pipeline.errors import RunError
from pipeline.private_folder import PrivateFolder
from pipeline.run.leftovers import cleanup, clear, forget_detached
from pipeline.run.memory_folder import MemoryFolder
from pipeline.run.rundir import FACTS, folder_of, locked, noted

CLAIM_S = 0.5  # a process that lists running graphs holds the lock for a moment
CLEANUP_S = 5.0  # a cleanup of leftovers holds it for as long as it takes
log = logging.getLogger(__name__)


@dataclass
class RunFolder:
    """The locked run folder of a graph, and its memory folder."""

    folder: PrivateFolder
    memory: MemoryFolder
    _lock: int

    @staticmethod
    def claim(graph: str) -> "RunFolder":
        """Claim the graph's name; raises `RunError` when it already runs or memory is short."""
        path = folder_of(graph)
        lock = _claimed(path)
        if lock is None:
            raise RunError(f"{graph}: already running, see `fovea ps`")
        try:
            folder = PrivateFolder(path)
            cleanup()
            clear(folder)
            forget_detached(folder)
            os.utime(lock)
            return RunFolder(folder, MemoryFolder.claim(), lock)
        except BaseException:
            os.close(lock)
            raise

    @property
    def run_id(self) -> str:
        """The unique id of this run, also in the command line of its processes."""
        return self.memory.run_id

    def to_read(self, process: str) -> str:
        """Return the command that shows a process's log."""
        return f"`fovea logs {self.folder.path.name} {process}`"

    def note(self, facts: dict[str, Any]) -> None:
        """Write the facts of this run for other processes.

        Raises `RunError` if the first write fails; a later failure leaves the former facts.
        """
        told = {"run": self.run_id, "pid": os.getpid(), **facts}
        try:
            self.folder.write(FACTS, json.dumps(told).encode())
        except OSError as error:
            sentence = f"{self.folder.path / FACTS}: cannot be written: {error.strerror}"
            if not self.folder.has(FACTS):
                raise RunError(sentence) from error
            log.warning("%s; process ids there are old", sentence)

    def release(self) -> None:
        """Remove sockets and memory; the logs stay for reading."""
        self.memory.empty()
        clear(self.folder)
        os.close(self._lock)


def _claimed(folder: Path) -> int | None:
    """Return the lock of a folder, waiting for processes that read or clean it up."""
    began_s = time.monotonic()
    while True:
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            lock = locked(folder, create=True)
        except OSError as error:
            raise RunError(f"{folder}: cannot be made: {error.strerror}") from error
        waited_s = time.monotonic() - began_s
        if lock is not None or waited_s > (CLAIM_S if _at_work(folder) else CLEANUP_S):
            return lock
        time.sleep(0.02)


def _at_work(folder: Path) -> bool:
    """Whether the supervisor recorded there is alive."""
    try:
        pid = noted(PrivateFolder(folder)).get("pid", 0)
    except RunError:
        return False
    return bool(pid) and psutil.pid_exists(pid)
