"""Files that a command writes: tried before anything runs, written whole or not at all."""

import json
import os
from pathlib import Path
from typing import Any

from pipeline.errors import SettingsError
from pipeline.text import said_by


def try_recording(path: Path, option: str) -> None:
    """Raise `SettingsError` unless a file can be written there; what is there stays as it is."""
    try:
        _try(path)
    except (OSError, ValueError) as error:
        raise SettingsError(_sentence(option, path, error)) from error


def try_report(path: Path, option: str) -> None:
    """Likewise for `write_report`; folders on the way there are made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if _is_special(path):
            _try(path)
        else:
            _try(_target(path))
            _try(_part(path))
    except (OSError, ValueError) as error:
        raise SettingsError(_sentence(option, path, error)) from error


def write_report(path: Path, report: dict[str, Any], option: str) -> str:
    """Write a report, an older one staying until it is whole; returns why it is not written."""
    text, part = json.dumps(report, indent=1), _part(path)
    try:
        if _is_special(path):
            path.write_text(text)
            return ""
        part.write_text(text)
        part.replace(_target(path))
    except (OSError, ValueError) as error:
        if not _is_special(path):
            part.unlink(missing_ok=True)
        return _sentence(option, path, error)
    return ""


def _try(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError(0, "expected a file, got a folder")
    flags = os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        handle = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        os.close(os.open(path, flags))
    else:
        os.close(handle)
        path.unlink()


def _is_special(path: Path) -> bool:
    """Whether it is a device or a pipe, which nothing can take the place of."""
    return path.exists() and not path.is_file() and not path.is_dir()


def _target(path: Path) -> Path:
    return path.resolve()  # a link stays a link


def _part(path: Path) -> Path:
    target = _target(path)
    return target.with_name(f"{target.name}.part")


def _sentence(option: str, path: Path, error: Exception) -> str:
    why = error.strerror if isinstance(error, OSError) and error.strerror else said_by(error)
    return f"{option} {path}: cannot be written: {why}"
