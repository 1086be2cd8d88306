"""The folder of a training: one that can be written, and in which no other training runs."""

import fcntl
import os
from pathlib import Path

from pipeline.errors import SettingsError
from pipeline.whole_file import try_beside

_held: dict[tuple[int, int], int] = {}  # by device and number of the folder: its open handle


def open_folder(out: Path) -> None:
    """Make the folder, and hold it until this process ends, however it ends.

    Raises `SettingsError` where another process trains in it, whose log and checkpoint would be
    mixed with this one's, or where nothing can be written, and `OSError` for what is no folder.
    """
    out.mkdir(parents=True, exist_ok=True)
    try:
        try_beside(out / "checkpoint.pt")
    except OSError as error:
        raise SettingsError(f"{out}: cannot be written: {error.strerror}") from error
    handle = os.open(out, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    facts = os.fstat(handle)
    if (facts.st_dev, facts.st_ino) in _held:
        os.close(handle)
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise SettingsError(
            f"{out}: another training runs in this folder; wait for it, or use another --out"
        ) from error
    except OSError:
        pass  # a file system without locks
    _held[facts.st_dev, facts.st_ino] = handle
