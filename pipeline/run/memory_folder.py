"""The folder of a run in shared memory: private, with a random name, locked while the run lives.

    /dev/shm/fovea-<uid>-<run>/   0700: ledger, <node>.<output>.<id>, <node>.<epoch>.state

Every user of a machine can write to /dev/shm, so nothing of a run lies there under a name that
could be guessed or made by somebody else. The supervisor holds a lock on the folder itself; a
folder whose lock is free belongs to a run that was killed, whatever else of it is left.
"""

import fcntl
import os
import re
import secrets
from collections.abc import Iterator
from pathlib import Path

from pipeline.errors import RunError
from pipeline.naming import GRAMMAR
from pipeline.private_folder import PrivateFolder

MEMORY = Path("/dev/shm")
RUN_ID = re.compile(r"[0-9a-f]{16}")
_FILES = re.compile(
    rf"ledger|{GRAMMAR}\.{GRAMMAR}\.[0-9a-f]{{8}}(\.part)?|{GRAMMAR}\.\d+\.state(\.part)?"
)


class MemoryFolder(PrivateFolder):
    """The locked memory folder of a run that lives."""

    run_id: str

    @staticmethod
    def claim(memory: Path = MEMORY) -> "MemoryFolder":
        """Make a folder for a new run and lock it; raises `RunError`."""
        while True:
            run_id = secrets.token_hex(8)
            path = path_of(run_id, memory)
            try:
                path.mkdir(mode=0o700)
                folder = MemoryFolder(path)
            except FileExistsError:
                continue
            except OSError as error:
                raise RunError(f"{path}: cannot be made: {error.strerror}") from error
            folder.run_id = run_id
            if folder.lock(fcntl.LOCK_EX) and folder.exists:  # else a cleanup was quicker
                return folder

    def lock(self, kind: int) -> bool:
        """Take the folder's lock until its descriptor is closed; False when another has it."""
        try:
            fcntl.flock(self.handle, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def empty(self) -> None:
        """Remove the files of a run, and then the folder; what is not known stays, with it."""
        for name in self.names():
            if _FILES.fullmatch(name):
                self.remove(name)
        self.remove_itself()

    def size_bytes(self) -> int:
        """What its files take."""
        found = (os.stat(n, dir_fd=self.handle, follow_symlinks=False) for n in self.names())
        return sum(seen.st_blocks * 512 for seen in found)


def path_of(run_id: str, memory: Path = MEMORY) -> Path:
    """The memory folder of a run of this user; raises `RunError` for what is no run's id."""
    if not RUN_ID.fullmatch(run_id):
        raise RunError(f"run: expected 16 hex digits, got {run_id[:40]!r}")
    return memory / f"fovea-{os.geteuid()}-{run_id}"


def abandoned(kind: int = fcntl.LOCK_EX, memory: Path = MEMORY) -> Iterator[MemoryFolder]:
    """The memory folders of runs of this user that were killed, each locked while it is in hand."""
    stem = f"fovea-{os.geteuid()}-"
    for name in sorted(os.listdir(memory)):
        run_id = name.removeprefix(stem)
        if not name.startswith(stem) or not RUN_ID.fullmatch(run_id):
            continue
        try:
            folder = MemoryFolder(memory / name)
        except RunError:
            continue  # gone meanwhile, or not ours
        folder.run_id = run_id
        if folder.lock(kind):
            yield folder
