"""Files that a command writes: tried before anything runs, written whole or not at all."""

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pipeline.errors import SettingsError
from pipeline.text import said_by
from pipeline.whole_file import try_beside, write_whole


def try_recording(path: Path, option: str) -> None:
    """Raise `SettingsError` unless a file can be written there; nothing there is changed."""
    try:
        _try(path)
    except (OSError, ValueError) as error:
        raise SettingsError(_sentence(option, path, error)) from error


def try_report(path: Path, option: str) -> None:
    """Likewise for `write_report`, which makes missing folders; those made here are removed."""
    try:
        with _folders_made(path.parent):
            _try(path)
            if not _is_special(path):
                try_beside(path.resolve())
    except (OSError, ValueError) as error:
        raise SettingsError(_sentence(option, path, error)) from error


def write_report(path: Path, report: dict[str, Any], option: str) -> str:
    """Write a report, an older one staying until it is whole; returns why it is not written."""
    text = json.dumps(report, indent=1)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if _is_special(path):
            path.write_text(text)
        else:
            write_whole(path.resolve(), text)  # a link stays a link
    except (OSError, ValueError) as error:
        return _sentence(option, path, error)
    return ""


def _try(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError(0, "expected a file, got a folder")
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC))
    except FileNotFoundError:
        try_beside(path.resolve())


@contextlib.contextmanager
def _folders_made(folder: Path) -> Iterator[None]:
    """With this folder and those above it; what had to be made for it goes again."""
    missing = [f for f in (folder, *folder.parents) if not f.exists()]
    made: list[Path] = []
    try:
        for one in reversed(missing):
            with contextlib.suppress(FileExistsError):  # someone else made it meanwhile
                one.mkdir()
                made.append(one)
        yield
    finally:
        for one in reversed(made):
            with contextlib.suppress(OSError):  # someone has put something there
                one.rmdir()


def _is_special(path: Path) -> bool:
    """Whether it is a device or a pipe, which nothing can take the place of."""
    return path.exists() and not path.is_file() and not path.is_dir()


def _sentence(option: str, path: Path, error: Exception) -> str:
    why = error.strerror if isinstance(error, OSError) and error.strerror else said_by(error)
    return f"{option} {path}: cannot be written: {why}"
