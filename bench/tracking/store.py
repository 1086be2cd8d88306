"""Storage of results: complete files, and drafts of unfinished ones; damaged files are removed."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

from pipeline.whole_file import write_whole

KEEP_S = 20.0  # between writings of a unit that is not finished: what an interruption may cost
Episode = dict[str, Any]  # start, iou, kept, shown, state, read_px, full_px
Unit = dict[str, Any]  # clip, case, target, kind, episodes


class Draft:
    """The episodes of a unit that is not finished, in a file beside it."""

    def __init__(self, path: Path) -> None:
        self._path, self._written_s = path, monotonic()
        self._episodes: dict[str, Episode] = _read(path, dict) or {}

    def known(self, target: int, start: int) -> Episode | None:
        """What an interrupted run found out about a start; None: nothing."""
        return self._episodes.get(f"{target} {start}")

    def add(self, target: int, episode: Episode) -> None:
        """Take one in, and write all of them now and then."""
        self._episodes[f"{target} {episode['start']}"] = episode
        if monotonic() - self._written_s >= KEEP_S:
            _write(self._path, self._episodes)
            self._written_s = monotonic()

    def finish(self, done: Sequence[Unit], path: Path) -> None:
        """Write the finished unit; what was kept of it is needed no more."""
        _write(path, done)
        self._path.unlink(missing_ok=True)


def units(path: Path) -> list[Unit]:
    """What a finished file holds."""
    found: list[Unit] = json.loads(path.read_text())
    return found


def forget_damaged(paths: Iterable[Path]) -> None:
    """Remove what a full disk or a crash left of a finished file: it is measured again."""
    for path in paths:
        if path.exists() and _read(path, list) is None:
            path.unlink()


def _read(path: Path, kind: type) -> Any:
    """What a file holds of that kind; None where it is not there, or damaged."""
    try:
        found = json.loads(path.read_text())
    except (FileNotFoundError, ValueError):
        return None
    return found if isinstance(found, kind) else None


def _write(path: Path, content: Any) -> None:
    write_whole(path, json.dumps(content))
