"""Open files that others wrote: a path in, an open regular file or its contents out.

A pipe waits for a writer and a device may never end, so that neither is opened as a file; and no
more than a limit is read.
"""

import io
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from pipeline.errors import DriverError
from pipeline.text import harmless

MOST_NAME = 400  # characters of a path in a sentence


@contextmanager
def opened(path: Path, most_bytes: int) -> Iterator[BinaryIO]:
    """Yield the file, open for reading.

    Raises `DriverError` when it is missing, longer, or no regular file.
    """
    where = harmless(str(path), MOST_NAME)
    try:
        # without waiting for the other end of a pipe
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except (OSError, ValueError) as error:  # a NUL in its name is a ValueError
        why = (isinstance(error, OSError) and error.strerror) or str(error)
        raise DriverError(f"{where}: cannot be read: {why}") from error
    with open(handle, "rb") as file:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            got = "a folder" if stat.S_ISDIR(found.st_mode) else "a device or a pipe"
            raise DriverError(f"{where}: cannot be read: expected a file, got {got}")
        if found.st_size > most_bytes:
            raise DriverError(f"{where}: expected at most {most_bytes} bytes, got {found.st_size}")
        yield file


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Return the contents of a file; raises `DriverError` as `opened` does."""
    with opened(path, most_bytes) as file:
        return contents(path, file, most_bytes)


def read_text(path: Path, most_bytes: int, encoding: str) -> str:
    """Return the contents as text with `\\n` between lines; also raises `UnicodeError`."""
    data = read_bytes(path, most_bytes)
    return io.TextIOWrapper(io.BytesIO(data), encoding=encoding).read()


def contents(path: Path, file: BinaryIO, most_bytes: int) -> bytes:
    """Return what an open file holds; raises `DriverError` for more, as some grow meanwhile."""
    where = harmless(str(path), MOST_NAME)
    try:
        data = file.read(most_bytes + 1)
    except OSError as error:
        raise DriverError(f"{where}: cannot be read: {error.strerror}") from error
    if len(data) > most_bytes:
        raise DriverError(f"{where}: expected at most {most_bytes} bytes, got more")
    return data


def library_name(path: Path, file: BinaryIO) -> str:
    """Return a name of an open file that C++ libraries take.

    OpenCV crashes on one that is not UTF-8, for which the name of the open file stands in.
    """
    name = os.fspath(path)
    try:
        name.encode()
    except UnicodeEncodeError:
        return f"/proc/self/fd/{file.fileno()}"
    return name
