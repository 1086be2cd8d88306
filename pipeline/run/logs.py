"""What the nodes of a graph wrote, also after they ended."""

import time
from collections.abc import Iterator
from pathlib import Path

from pipeline.errors import RunError
from pipeline.naming import is_name
from pipeline.private_folder import PrivateFolder
from pipeline.run.rundir import folder_of, running
from pipeline.text import harmless


def log_lines(graph: str, node: str, lines: int, *, follow: bool) -> Iterator[str]:
    """The last lines of a node's log, then whatever is added."""
    path = _log_path(graph, node)
    with path.open(errors="replace") as file:
        yield from file.read().splitlines()[-lines:] if lines else []
        while follow:
            if line := file.readline():
                yield line.rstrip("\n")
            else:
                time.sleep(0.2)


def _log_path(graph: str, node: str) -> Path:
    """The log of that node, which writes into the log of its process."""
    folder = folder_of(graph)
    nodes = running().get(graph, {"nodes": []})["nodes"]
    process = next((n["process"] for n in nodes if n["name"] == node), node)
    if not is_name(node) or not folder.is_dir() or not PrivateFolder(folder).has(f"{process}.log"):
        raise RunError(f"no log of a node {harmless(node)} in graph {graph}")
    return folder / f"{process}.log"
