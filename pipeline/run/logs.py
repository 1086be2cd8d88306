"""Logs of a graph's nodes, also after the graph has ended."""

import time
from collections.abc import Iterator
from pathlib import Path

from pipeline.errors import RunError
from pipeline.naming import is_name
from pipeline.private_folder import PrivateFolder
from pipeline.run.rundir import folder_of, running
from pipeline.text import harmless


def log_lines(graph: str, node: str, lines: int, *, follow: bool) -> Iterator[str]:
    """Yield the last lines of a node's log, then new ones if `follow`."""
    path = _log_path(graph, node)
    with path.open(errors="replace") as file:
        yield from file.read().splitlines()[-lines:] if lines else []
        while follow:
            if line := file.readline():
                yield line.rstrip("\n")
            else:
                time.sleep(0.2)


def _log_path(graph: str, node: str) -> Path:
    """Return the log file of a node's process."""
    folder = folder_of(graph)
    nodes = running().get(graph, {"nodes": []})["nodes"]
    process = next((n["process"] for n in nodes if n["name"] == node), node)
    if not is_name(node) or not folder.is_dir() or not PrivateFolder(folder).has(f"{process}.log"):
        raise RunError(f"no log of a node {harmless(node)} in graph {graph}")
    return folder / f"{process}.log"
