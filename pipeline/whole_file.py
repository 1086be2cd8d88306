"""Files that are written whole or not at all, beside which nothing of anyone else is touched.

A temporary file with a random name is made in the same folder, never opened if there is one
already, and takes the file's name when everything is in it. It is removed when that fails.
"""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import IO

PREFIX, SUFFIX = ".fovea-", ".part"  # of the temporary file, which any folder has room for
_MAKE = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


@contextlib.contextmanager
def whole_file(path: Path, *, secret: bool = False, durable: bool = False) -> Iterator[IO[bytes]]:
    """The file that becomes `path` when the block ends without an exception.

    A link there is replaced, not followed. Its mode is what the umask says, or 0600 for a secret;
    one that is durable is there after a power failure, too. Raises `OSError`.
    """
    with _folder(path) as folder, _temporary(folder, 0o600 if secret else 0o666) as (name, handle):
        with os.fdopen(handle, "w+b") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        os.rename(name, path.name, src_dir_fd=folder, dst_dir_fd=folder)


def write_whole(
    path: Path, data: bytes | str, *, secret: bool = False, durable: bool = False
) -> None:
    """Give a file these contents, all of them or none; raises `OSError` as `whole_file` does."""
    with whole_file(path, secret=secret, durable=durable) as file:
        file.write(data.encode() if isinstance(data, str) else data)


def try_beside(path: Path) -> None:
    """Raise `OSError` unless a file can be made in the folder of `path`, which stays as it is."""
    with _folder(path) as folder, _temporary(folder, 0o600) as (_, handle):
        os.close(handle)


@contextlib.contextmanager
def _folder(path: Path) -> Iterator[int]:
    handle = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield handle
    finally:
        os.close(handle)


@contextlib.contextmanager
def _temporary(folder: int, mode: int) -> Iterator[tuple[str, int]]:
    """A new file's name and descriptor; what still has the name afterwards is removed."""
    name = f"{PREFIX}{secrets.token_hex(8)}{SUFFIX}"
    handle = os.open(name, _MAKE, mode, dir_fd=folder)
    try:
        yield name, handle
    finally:
        with contextlib.suppress(OSError):
            os.unlink(name, dir_fd=folder)
