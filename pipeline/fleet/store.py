"""The persisted state of an agent: the graphs it runs, so that they resume after a restart."""

import json
from pathlib import Path

from pipeline.errors import MessageError, RunError
from pipeline.protocol.codec import decode, encode
from pipeline.protocol.fleet import Start
from pipeline.whole_file import write_whole


class GraphStore:
    """A folder with two files per graph: what was asked, and how often it began."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def names(self) -> list[str]:
        """The graphs that ran when this host ended."""
        return sorted(path.stem for path in self._folder.glob("*.graph"))

    def keep(self, graph: str, asked: Start) -> None:
        """Note what was asked; raises `RunError` when that cannot be."""
        self._write(self._folder / f"{graph}.graph", encode(asked))

    def asked(self, graph: str) -> Start:
        """What was asked; raises `MessageError` for a file that does not say."""
        path = self._folder / f"{graph}.graph"
        try:
            return decode(Start, path.read_bytes())
        except (OSError, MessageError) as error:
            raise MessageError(f"{path}: not what an agent wrote: {error}") from error

    def count(self, graph: str) -> int:
        """One more start of a graph: how many there were. It never counts back."""
        path = self._folder / f"{graph}.starts"
        try:
            before = int(json.loads(path.read_text()))
        except FileNotFoundError:
            before = 0
        except (OSError, ValueError, TypeError) as error:
            raise RunError(
                f"{path}: expected a number; remove it on every host: {error}"
            ) from error
        self._write(path, str(before + 1).encode())
        return before + 1

    def forget(self, graph: str) -> None:
        """It is taken down; others that know its numbers are, too."""
        for kind in ("graph", "starts"):
            (self._folder / f"{graph}.{kind}").unlink(missing_ok=True)

    def _write(self, path: Path, data: bytes) -> None:
        """All of it or nothing, also when the power fails."""
        try:
            write_whole(path, data, durable=True)
        except OSError as error:
            raise RunError(f"{path}: cannot be written: {error.strerror}") from error
