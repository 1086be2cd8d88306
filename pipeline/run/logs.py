"""Logs of a graph's nodes, also after the graph has ended."""

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

from pipeline.errors import RunError
from pipeline.naming import is_name
from pipeline.private_folder import PrivateFolder
from pipeline.run.rundir import folder_of, running
from pipeline.text import harmless

MOST_PART_BYTES = 256 << 10  # a byte that is no UTF-8 is sent as three
FOLLOW_S = 0.2  # between two looks for new lines


def log_lines(graph: str, node: str, lines: int, *, follow: bool) -> Iterator[str]:
    """Yield the last lines of a node's log, then new ones if `follow`."""
    path = _log_path(graph, node)
    with ExitStack() as opened:
        file = opened.enter_context(path.open(errors="replace"))
        yield from file.read().splitlines()[-lines:] if lines else []
        while follow:
            if line := file.readline():
                yield line.rstrip("\n")
            elif _begun_anew(path, file):
                yield from file.read().splitlines()  # what came before it was renamed
                opened.close()
                file = opened.enter_context(path.open(errors="replace"))
            elif os.fstat(file.fileno()).st_size < os.lseek(file.fileno(), 0, os.SEEK_CUR):
                file.seek(0)  # emptied by a new run
            else:
                time.sleep(FOLLOW_S)


def log_part(
    graph: str, node: str, count: int, begin: int | None = None
) -> tuple[tuple[str, ...], int]:
    """Return up to `count` whole lines of a node's log, and the byte behind them.

    They are those from byte `begin` on, or else the last ones. A log that has become shorter is
    read from its beginning.
    """
    with _log_path(graph, node).open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        start = max(0, size - MOST_PART_BYTES) if begin is None else begin if begin <= size else 0
        file.seek(start)
        rows = file.read(MOST_PART_BYTES).splitlines(keepends=True)
    if rows and not rows[-1].endswith(b"\n") and len(rows[-1]) < MOST_PART_BYTES:
        del rows[-1]  # it is still written
    kept = rows[max(0, len(rows) - count) :] if begin is None else rows[:count]
    end = start + sum(map(len, rows if begin is None else kept))
    return tuple(row.decode(errors="replace").rstrip("\n") for row in kept), end


def _begun_anew(path: Path, file: TextIO) -> bool:
    """Whether a log has become too long, was renamed, and another one begun in its place."""
    try:
        return not os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except FileNotFoundError:  # not yet, or the graph has ended
        return False


def _log_path(graph: str, node: str) -> Path:
    """Return the log file of a node's process."""
    folder = folder_of(graph)
    nodes = running().get(graph, {"nodes": []})["nodes"]
    process = next((n["process"] for n in nodes if n["name"] == node), node)
    if not is_name(node) or not folder.is_dir() or not PrivateFolder(folder).has(f"{process}.log"):
        raise RunError(f"no log of a node {harmless(node)} in graph {graph}")
    return folder / f"{process}.log"
