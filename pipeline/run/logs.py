"""What the nodes of a graph wrote, also after they ended."""

import time
from collections.abc import Iterator
from pathlib import Path

from pipeline.errors import RunError
from pipeline.naming import is_name
from pipeline.private_folder import PrivateFolder
from pipeline.run.rundir import folder_of, run_folders, running


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
    """The newest log of that node, of the graph named or of any."""
    alive, found = running(), []
    folders = [folder_of(graph)] if graph else [folder.path for folder in run_folders()]
    for path in folders if is_name(node) else ():
        nodes = alive.get(path.name, {"nodes": []})["nodes"]
        process = next((n["process"] for n in nodes if n["name"] == node), node)
        if path.is_dir() and PrivateFolder(path).has(f"{process}.log"):
            found.append(path / f"{process}.log")
    if not found:
        raise RunError(f"no log of a node {node}" + (f" in graph {graph}" if graph else ""))
    return max(found, key=lambda path: path.stat().st_mtime)
