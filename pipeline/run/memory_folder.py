"""A run's folder in shared memory: private, with a random name, locked while the run lives.

    /dev/shm/fovea-<uid>-<run>/   0700: ledger, <node>.<output>.<id>, <node>.<epoch>.state

Every user of a machine can write to /dev/shm, so no name of a run there can be guessed or created
by another user. The supervisor holds a lock on the folder itself; a folder with a free lock belongs
to a killed run.
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
_POOL = re.compile(rf"({GRAMMAR}\.{GRAMMAR})\.[0-9a-f]{{8}}")


class MemoryFolder(PrivateFolder):
    """The locked memory folder of a live run."""

    run_id: str

    @staticmethod
    def claim(memory: Path = MEMORY) -> "MemoryFolder":
        """Create a folder for a new run and lock it; raises `RunError`."""
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
            if folder.lock(fcntl.LOCK_EX) and folder.exists:  # otherwise a cleanup was faster
                return folder

    def lock(self, kind: int) -> bool:
        """Lock the folder until its descriptor is closed; return False if it is locked already."""
        try:
            fcntl.flock(self.handle, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def empty(self) -> None:
        """Remove the files of a run, then the folder, which stays if it has unknown files."""
        for name in self.names():
            if _FILES.fullmatch(name):
                self.remove(name)
        self.remove_itself()

    def unknown(self) -> list[str]:
        """Return the names of files that no run makes, which are never removed."""
        return [name for name in self.names() if not _FILES.fullmatch(name)]

    def pool_bytes(self) -> dict[str, int]:
        """Return the sizes of the frame pools in bytes, by `node.output`, without outgrown ones."""
        found: dict[str, int] = {}
        for name in self.names():
            pool, seen = _POOL.fullmatch(name), self._seen(name)
            if pool and seen:
                found[pool[1]] = max(found.get(pool[1], 0), seen.st_size)
        return found

    def size_bytes(self) -> int:
        """Return the total size of its files in bytes."""
        found = (os.stat(n, dir_fd=self.handle, follow_symlinks=False) for n in self.names())
        return sum(seen.st_blocks * 512 for seen in found)


def path_of(run_id: str, memory: Path = MEMORY) -> Path:
    """Return the memory folder of a run of this user; raises `RunError` for an invalid id."""
    if not RUN_ID.fullmatch(run_id):
        raise RunError(f"run: expected 16 hex digits, got {run_id[:40]!r}")
    return memory / f"fovea-{os.geteuid()}-{run_id}"


def abandoned(kind: int = fcntl.LOCK_EX, memory: Path = MEMORY) -> Iterator[MemoryFolder]:
    """Yield the memory folders of this user's killed runs, each locked while it is used."""
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
