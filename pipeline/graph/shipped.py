"""The shipped graphs and sources by name: `tracking` -> the path of its file.

They are in `graphs/`, next to this package, in the source tree and in an installation alike. Any
other argument is the path of a file.
"""

import difflib
import os
from pathlib import Path

from pipeline.errors import GraphError
from pipeline.wording import shown

FOLDER = Path(__file__).resolve().parents[2] / "graphs"
SOURCES, TASKS = FOLDER / "sources", FOLDER / "tasks"
SUFFIXES = (".yaml", ".yml")


def graph_names(folder: Path = FOLDER) -> list[str]:
    """Return the names of the graphs; those in a sub-folder are `folder/name`."""
    others = (SOURCES, TASKS)
    return [name for name in _names(folder) if folder / name.partition("/")[0] not in others]


def source_names() -> list[str]:
    """Return the names of the sources for `--source`."""
    return _names(SOURCES)


def graph_path(word: str | os.PathLike[str]) -> Path:
    """Return the file of a graph by name or path; raises `GraphError` for an unknown name.

    >>> graph_path("tracking").relative_to(FOLDER), graph_path("my/graph.yaml")
    (PosixPath('tracking.yaml'), PosixPath('my/graph.yaml'))
    """
    return _path(os.fspath(word), "graph", FOLDER, graph_names())


def source_path(word: str | os.PathLike[str]) -> Path:
    """Return the file of a source by name or path; raises `GraphError` for an unknown name."""
    return _path(os.fspath(word), "source", SOURCES, source_names())


def name_of(path: Path) -> str:
    """Return the name of a shipped graph by its path; of any other file the path.

    >>> name_of(FOLDER / "examples" / "blend.yaml"), name_of(Path("my/graph.yaml"))
    ('examples/blend', 'my/graph.yaml')
    """
    inside = path.suffix in SUFFIXES and path.is_absolute() and path.is_relative_to(FOLDER)
    return path.relative_to(FOLDER).with_suffix("").as_posix() if inside else str(path)


def _names(folder: Path) -> list[str]:
    found = (path.relative_to(folder).with_suffix("") for path in folder.rglob("*.yaml"))
    return sorted(path.as_posix() for path in found)


def _path(word: str, kind: str, folder: Path, names: list[str]) -> Path:
    if word in names:
        return folder / f"{word}.yaml"
    path = Path(word)
    is_path = path.suffix in SUFFIXES or path.is_absolute() or word.startswith(".") or not word
    if is_path or os.path.lexists(path):
        return path
    near = difflib.get_close_matches(word[:100], names, 1, 0.6)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise GraphError(
        f"{shown(word)}: no such {kind}; {hint}there is {', '.join(names)}; one of your own is "
        "named by its path, with .yaml"
    )
