"""Output files of a command: checked before anything runs, written atomically."""

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
    """Raise `SettingsError` unless a file can be written there; change nothing."""
    try:
        _try(path)
    except (OSError, ValueError) as error:
        raise SettingsError(_sentence(option, path, error)) from error


def try_report(path: Path, option: str) -> None:
    """Check a path for `write_report`, which creates missing folders; remove those made here."""
    try:
        with _folders_made(path.parent):
            _try(path)
            if not _is_special(path):
                try_beside(path.resolve())
    except (OSError, ValueError) as error:
        raise SettingsError(_sentence(option, path, error)) from error


def write_report(path: Path, report: dict[str, Any], option: str) -> str:
    """Replace a report atomically; return an error sentence, or an empty string."""
    return write_text(path, json.dumps(report, indent=1), option)


def write_text(path: Path, text: str, option: str) -> str:
    """Replace a file atomically, or write to a device; return a sentence as `write_report` does."""
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
    """Create a folder and its parents for the block; remove those created."""
    missing = [f for f in (folder, *folder.parents) if not f.exists()]
    made: list[Path] = []
    try:
        for one in reversed(missing):
            with contextlib.suppress(FileExistsError):  # created by another process meanwhile
                one.mkdir()
                made.append(one)
        yield
    finally:
        for one in reversed(made):
            with contextlib.suppress(OSError):  # another process has put a file there
                one.rmdir()


def _is_special(path: Path) -> bool:
    """Whether it is a device or a pipe, which cannot be replaced by a file."""
    return path.exists() and not path.is_file() and not path.is_dir()


def _sentence(option: str, path: Path, error: Exception) -> str:
    why = error.strerror if isinstance(error, OSError) and error.strerror else said_by(error)
    return f"{option} {path}: cannot be written: {why}"
