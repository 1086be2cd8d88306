"""Where a running graph keeps its sockets, logs and shared memory, and how remains are removed.

    <tmp>/fovea-<uid>/<graph>/   0700: lock, run.json, <process>.sock, <process>.log
    /dev/shm/fovea-<run>-…       the ledger and the frame pools of one run

Whoever holds the lock owns the graph. A folder whose lock is free belongs to nobody: the next start
removes what it left in memory and ends what it left running.
"""

import contextlib
import fcntl
import json
import logging
import os
import secrets
import shutil
import signal
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from pipeline.bus.pool import remove_pools
from pipeline.errors import RunError
from pipeline.run.descendants import end_marked

MEMORY = Path("/dev/shm")
LOGS = (".log", ".old")
KEEP_LOGS_S = 7 * 86400.0  # of graphs that run no more
CLAIM_S = 0.5  # who looks whether a graph runs has its lock for a moment
SWEEP_S = 5.0  # who removes what a killed one left has it for as long as that takes
log = logging.getLogger(__name__)


def base() -> Path:
    """The folder of this user's graphs, made when it is not there; raises `RunError`."""
    folder = Path(tempfile.gettempdir()) / f"fovea-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    seen = folder.lstat()
    if seen.st_uid != os.getuid() or seen.st_mode & 0o077 or not folder.is_dir():
        raise RunError(f"{folder}: expected a private folder of this user, got somebody else's")
    return folder


@dataclass
class RunFolder:
    """The owned folder of a running graph."""

    folder: Path
    prefix: str
    _lock: int

    @staticmethod
    def claim(graph: str) -> "RunFolder":
        """Own the graph's name; raises `RunError` when it runs already, or there is no room."""
        folder = base() / graph
        lock = _claimed(folder)
        if lock is None:
            raise RunError(f"{graph}: already running, see `fovea ps`")
        try:
            sweep()
            _remove_remains(folder)
            os.utime(folder / "lock")
        except BaseException:
            os.close(lock)
            raise
        prefix = f"fovea-{secrets.token_hex(4)}-"
        return RunFolder(folder, prefix, lock)

    def note(self, facts: dict[str, Any]) -> None:
        """Write down what others may want to know about this run.

        Raises `RunError` when that cannot be; later on what was written down before must do.
        """
        path, part = self.folder / "run.json", self.folder / "run.json.part"
        try:
            part.write_text(json.dumps({"prefix": self.prefix, "pid": os.getpid(), **facts}))
            part.rename(path)
        except OSError as error:
            part.unlink(missing_ok=True)
            sentence = f"{path}: cannot be written: {error.strerror}"
            if not path.exists():
                raise RunError(sentence) from error
            log.warning("%s; process ids there are old", sentence)

    def release(self) -> None:
        """Remove sockets and memory; the logs stay for reading."""
        remove_pools(MEMORY, self.prefix)
        for path in (*_remains(self.folder), self.folder / "run.json"):
            path.unlink(missing_ok=True)
        os.close(self._lock)


def running() -> dict[str, dict[str, Any]]:
    """What is noted of every graph of this user that runs now, by name."""
    found = {}
    for folder in sorted(base().iterdir()):
        lock = _locked(folder, fcntl.LOCK_SH)  # so that two who look see the same
        if lock is not None:
            os.close(lock)
            continue
        try:
            found[folder.name] = json.loads((folder / "run.json").read_text())
        except (OSError, ValueError):
            continue
    return found


def leftovers() -> list[str]:
    """Graphs of this user whose supervisor was killed and left something beside its logs."""
    found = []
    for folder in sorted(base().iterdir()):
        lock = _locked(folder, fcntl.LOCK_SH)  # so that two who look see the same
        if lock is not None:  # held until it was looked into, or a sweep takes the folder away
            if (folder / "run.json").exists() or _remains(folder):
                found.append(folder.name)
            os.close(lock)
    return found


def sweep() -> None:
    """Remove what killed supervisors left behind."""
    for folder in base().iterdir():
        lock = _locked(folder)
        if lock is None:
            continue
        try:
            _remove_remains(folder)
            if time.time() - (folder / "lock").stat().st_mtime > KEEP_LOGS_S:
                shutil.rmtree(folder, ignore_errors=True)
        finally:
            os.close(lock)


def _claimed(folder: Path) -> int | None:
    """The lock, also when somebody who only looks has it for a moment, or sweeps it away."""
    began_s = time.monotonic()
    while True:
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            lock = _locked(folder, create=True)
        except OSError as error:
            raise RunError(f"{folder}: cannot be made: {error.strerror}") from error
        waited_s = time.monotonic() - began_s
        if lock is not None or waited_s > (CLAIM_S if _at_work(folder) else SWEEP_S):
            return lock
        time.sleep(0.02)


def _at_work(folder: Path) -> bool:
    """Whether the supervisor that is noted there lives."""
    try:
        pid = int(json.loads((folder / "run.json").read_text())["pid"])
        return bool(psutil.pid_exists(pid))
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _locked(folder: Path, kind: int = fcntl.LOCK_EX, *, create: bool = False) -> int | None:
    """The lock of a folder, or None when another has it; raises `OSError` only to `create`."""
    path = folder / "lock"
    try:
        handle = os.open(path, os.O_RDWR | os.O_CLOEXEC | (os.O_CREAT if create else 0), 0o600)
    except OSError:
        if create and folder.is_dir():
            raise
        return None
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(handle), path.stat()):
            return handle
    except (BlockingIOError, FileNotFoundError):
        pass  # somebody has it, or it was swept away between the two lines
    os.close(handle)
    return None


def _remove_remains(folder: Path) -> None:
    try:
        prefix = str(json.loads((folder / "run.json").read_text())["prefix"])
    except (OSError, ValueError, KeyError, TypeError):
        prefix = ""
    if prefix.startswith("fovea-"):
        _end_orphans(prefix)
        remove_pools(MEMORY, prefix)
    for path in (*_remains(folder), folder / "run.json"):
        path.unlink(missing_ok=True)


def _remains(folder: Path) -> list[Path]:
    """Whatever a run leaves beside its lock, its facts and its logs, also files not known here."""
    return [
        path
        for path in folder.iterdir()
        if path.name not in ("lock", "run.json") and path.suffix not in LOGS and not path.is_dir()
    ]


def _end_orphans(prefix: str) -> None:
    """Nodes end by themselves when their supervisor dies; a frozen one cannot."""
    for process in psutil.process_iter(["cmdline"]):
        if prefix in (process.info["cmdline"] or []):
            with contextlib.suppress(psutil.Error):  # it has just ended by itself
                process.send_signal(signal.SIGKILL)
    end_marked(prefix)  # and what they had started
