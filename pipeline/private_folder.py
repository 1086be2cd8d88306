"""Create, read and remove files in folders that only this user can enter, by descriptor.

Every user of a machine can write to shared memory and the temporary folder. fovea's files there are
in folders of mode 0700. Every access goes through the descriptor of a folder that was checked once,
never follows a link and refuses files of other users, so that no other user can substitute one.
"""

import contextlib
import os
import stat
import weakref
from pathlib import Path

from pipeline.errors import RunError

MODE = 0o700
FILE_MODE = 0o600
MOST_BYTES = 64 << 20  # upper limit of a file that is read as a whole
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


class PrivateFolder:
    """An open folder of this user with mode 0700; closed when it is garbage-collected."""

    def __init__(self, path: Path) -> None:
        """Open an existing folder; raises `RunError` unless it is private to this user."""
        self.path = path
        try:
            self.handle = os.open(path, _FOLDER)
        except OSError as error:
            raise RunError(f"{path}: cannot be opened as a folder: {error.strerror}") from error
        weakref.finalize(self, os.close, self.handle).atexit = False
        seen = os.fstat(self.handle)
        if seen.st_uid != os.geteuid() or seen.st_mode & 0o077:
            raise RunError(
                f"{path}: expected a folder of user {os.geteuid()} with mode 700, got one of user "
                f"{seen.st_uid} with mode {stat.S_IMODE(seen.st_mode):o}"
            )

    @staticmethod
    def make(path: Path) -> "PrivateFolder":
        """Make the folder, which must not exist; raises `FileExistsError` or `RunError`."""
        try:
            path.mkdir(mode=MODE)
        except FileExistsError:
            raise
        except OSError as error:
            raise RunError(f"{path}: cannot be made: {error.strerror}") from error
        return PrivateFolder(path)

    @property
    def exists(self) -> bool:
        """Whether the path still leads to this folder."""
        try:
            return os.path.samestat(os.fstat(self.handle), self.path.lstat())
        except FileNotFoundError:
            return False

    def names(self) -> list[str]:
        """Return the names of all entries, sorted."""
        return sorted(os.listdir(self.handle))

    def has(self, name: str) -> bool:
        """Whether there is a regular file of this user by that name."""
        return _is_own(self._seen(name), stat.S_IFREG)

    def create(self, name: str) -> int:
        """Create a file and return its read-write descriptor; raises `OSError` if it exists."""
        return self._open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL)

    def open(self, name: str, *, writable: bool = False) -> int:
        """Return a descriptor of a regular file of this user; raises `OSError` for any other."""
        handle = self._open(name, (os.O_RDWR if writable else os.O_RDONLY) | os.O_NONBLOCK)
        if _is_own(os.fstat(handle), stat.S_IFREG):
            return handle
        os.close(handle)
        raise PermissionError(1, "not a file of this user", name)

    def read(self, name: str, most_bytes: int = MOST_BYTES) -> bytes:
        """Return the contents of a file; raises `OSError`, also above `most_bytes`."""
        with os.fdopen(self.open(name), "rb") as file:
            data = file.read(most_bytes + 1)
        if len(data) > most_bytes:
            raise OSError(27, f"longer than {most_bytes} bytes", name)
        return data

    def write(self, name: str, data: bytes) -> None:
        """Write a file atomically; raises `OSError`."""
        part = f"{name}.part"
        self.remove(part)
        try:
            with os.fdopen(self.create(part), "wb") as file:
                file.write(data)
            os.rename(part, name, src_dir_fd=self.handle, dst_dir_fd=self.handle)
        except OSError:
            self.remove(part)
            raise

    def rename(self, name: str, new: str) -> None:
        """Rename a file, replacing any file with the new name."""
        os.rename(name, new, src_dir_fd=self.handle, dst_dir_fd=self.handle)

    def remove(self, name: str) -> bool:
        """Remove a file or socket of this user; return whether there was one."""
        if not _is_own(self._seen(name), stat.S_IFREG, stat.S_IFSOCK):
            return False
        with contextlib.suppress(OSError):  # already gone, or the file system is read-only
            os.unlink(name, dir_fd=self.handle)
            return True
        return False

    def remove_itself(self) -> bool:
        """Remove the folder if it is empty and still at its path; return whether it was removed."""
        if self.exists:
            with contextlib.suppress(OSError):
                self.path.rmdir()
                return True
        return False

    def _open(self, name: str, flags: int) -> int:
        if "/" in name or name in ("", ".", ".."):
            raise ValueError(f"{self.path}: expected the name of a file in it, got {name!r}")
        safe = flags | os.O_NOFOLLOW | os.O_CLOEXEC
        return os.open(name, safe, FILE_MODE, dir_fd=self.handle)

    def _seen(self, name: str) -> os.stat_result | None:
        if "/" in name or name in ("", ".", ".."):
            raise ValueError(f"{self.path}: expected the name of a file in it, got {name!r}")
        try:
            return os.stat(name, dir_fd=self.handle, follow_symlinks=False)
        except OSError:
            return None


def _is_own(seen: os.stat_result | None, *kinds: int) -> bool:
    """Whether an entry is of one of these kinds and belongs to this user."""
    return seen is not None and seen.st_uid == os.geteuid() and stat.S_IFMT(seen.st_mode) in kinds
