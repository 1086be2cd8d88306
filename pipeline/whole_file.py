"""Write files atomically, without touching any other file in the folder.

A new temporary file with a random name is written in the same folder and renamed to the final name
when it is complete. It is removed when that fails.
"""

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO

PREFIX, SUFFIX = ".fovea-", ".part"  # of the temporary file's name
_MAKE = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


@contextlib.contextmanager
def whole_file(path: Path, *, secret: bool = False, durable: bool = False) -> Iterator[IO[bytes]]:
    """Yield a file that becomes `path` when the block ends without an exception.

    A link at `path` is replaced, not followed. The mode follows the umask, or is 0600 with
    `secret`; with `durable` the file survives a power failure. Raises `OSError`, also for a device
    or a pipe, and a link to one such as `/dev/stdout`, which a file would replace for everybody.
    """
    if _is_special(path):
        raise OSError(errno.EINVAL, "expected a regular file, got a device or a pipe", str(path))
    with _folder(path) as folder, _temporary(folder, 0o600 if secret else 0o666) as (name, handle):
        with os.fdopen(handle, "w+b") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        os.rename(name, path.name, src_dir_fd=folder, dst_dir_fd=folder)


def write_whole(
    path: Path, data: bytes | memoryview | str, *, secret: bool = False, durable: bool = False
) -> None:
    """Write a file atomically; raises `OSError` as `whole_file` does, always with the file."""
    try:
        with whole_file(path, secret=secret, durable=durable) as file:
            file.write(data.encode() if isinstance(data, str) else data)
    except OSError as error:
        if error.filename is None:  # of a write: a full disk, or a limit
            error.filename = str(path)
        raise


def try_beside(path: Path) -> None:
    """Raise `OSError` unless a file can be created in the folder of `path`; change nothing."""
    with _folder(path) as folder, _temporary(folder, 0o600) as (_, handle):
        os.close(handle)


def _is_special(path: Path) -> bool:
    """Whether there is, or a link leads to, something that is neither a file nor a folder."""
    try:
        kind = path.stat().st_mode
        # what a process has open may be a file, too; its name in /dev is not that file's
        opened = path.is_symlink() and os.readlink(path).startswith("/proc/")
    except OSError:  # nothing, or a link to nothing
        return False
    return opened or not (stat.S_ISREG(kind) or stat.S_ISDIR(kind))


@contextlib.contextmanager
def _folder(path: Path) -> Iterator[int]:
    handle = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield handle
    finally:
        os.close(handle)


@contextlib.contextmanager
def _temporary(folder: int, mode: int) -> Iterator[tuple[str, int]]:
    """Yield a new file's name and descriptor; afterwards remove the file if it still exists."""
    name = f"{PREFIX}{secrets.token_hex(8)}{SUFFIX}"
    handle = os.open(name, _MAKE, mode, dir_fd=folder)
    try:
        yield name, handle
    finally:
        with contextlib.suppress(OSError):
            os.unlink(name, dir_fd=folder)
