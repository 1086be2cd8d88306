"""Storage of results: complete files, and drafts of unfinished ones; damaged files are removed."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

from pipeline.whole_file import write_whole

KEEP_S = 20.0  # between two writes of an unfinished unit: the most that an interruption loses
Episode = dict[str, Any]  # start, iou, kept, shown, state, read_px, full_px
Unit = dict[str, Any]  # clip, case, target, kind, episodes


class Draft:
    """The episodes of an unfinished unit, in a file beside it."""

    def __init__(self, path: Path) -> None:
        self._path, self._written_s = path, monotonic()
        self._episodes: dict[str, Episode] = _read(path, dict) or {}

    def known(self, target: int, start: int) -> Episode | None:
        """Return the episode of a start from an interrupted run; None if there is none."""
        return self._episodes.get(f"{target} {start}")

    def add(self, target: int, episode: Episode) -> None:
        """Add an episode; write all of them every `KEEP_S`."""
        self._episodes[f"{target} {episode['start']}"] = episode
        if monotonic() - self._written_s >= KEEP_S:
            _write(self._path, self._episodes)
            self._written_s = monotonic()

    def finish(self, done: Sequence[Unit], path: Path) -> None:
        """Write the finished unit and remove the draft."""
        _write(path, done)
        self._path.unlink(missing_ok=True)


def units(path: Path) -> list[Unit]:
    """Return the units of a finished file."""
    found: list[Unit] = json.loads(path.read_text())
    return found


def forget_damaged(paths: Iterable[Path]) -> None:
    """Remove files damaged by a full disk or a crash, so that their units are measured again."""
    for path in paths:
        if path.exists() and _read(path, list) is None:
            path.unlink()


def _read(path: Path, kind: type) -> Any:
    """Return the content of a file; None if it is missing, damaged or of another kind."""
    try:
        found = json.loads(path.read_text())
    except (FileNotFoundError, ValueError):
        return None
    return found if isinstance(found, kind) else None


def _write(path: Path, content: Any) -> None:
    write_whole(path, json.dumps(content))
