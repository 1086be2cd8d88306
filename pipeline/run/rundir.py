"""Run folders of graphs (sockets, logs, facts), and which graphs are running.

    <tmp>/fovea-<uid>/<graph>/   0700: lock, run.json, <process>.<epoch>.sock, <process>.log …

The process that holds the lock owns the graph's name. A folder with a free lock belongs to no run:
the next start removes leftovers of a killed run there (`pipeline.run.leftovers`).
"""

import contextlib
import fcntl
import os
import stat
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from pipeline.errors import RunError
from pipeline.naming import is_name
from pipeline.private_folder import PrivateFolder
from pipeline.run.memory_folder import RUN_ID, path_of

FACTS, LOCK = "run.json", "lock"
MOST_FACTS_BYTES = 4 << 20
LONGEST_ADDRESS = 107  # bytes of a unix socket's path
NEWEST_EPOCH = 9_999_999  # largest number of an instance


class _NodeFacts(msgspec.Struct):
    name: str
    index: int
    process: str
    operator: str


class _EdgeFacts(msgspec.Struct, rename={"origin": "from", "end": "to"}):
    origin: str
    end: str
    index: int


class _Facts(msgspec.Struct):
    """The recorded facts of a run, as validated by readers."""

    graph: str
    run: str
    pid: int
    clock: str
    nodes: list[_NodeFacts]
    edges: list[_EdgeFacts]
    plan: dict[str, Any]
    revision: int
    pids: dict[str, int]  # by process
    restarts: dict[str, int] = {}  # by process
    crashes: dict[str, int] = {}  # by process
    gone: list[str] = []  # processes that ended and will not restart


_READ = msgspec.json.Decoder(_Facts)


def base() -> Path:
    """Return the folder of this user's graphs, creating it if needed; raises `RunError`."""
    parent = Path(tempfile.gettempdir())
    path = parent / f"fovea-{os.geteuid()}"
    seen = parent.stat()
    if seen.st_mode & 0o022 and not seen.st_mode & stat.S_ISVTX:
        raise RunError(f"{parent}: others may rename what lies in it: expected a sticky folder")
    try:
        path.mkdir(mode=0o700)
    except FileExistsError:
        pass
    except OSError as error:
        raise RunError(f"{path}: cannot be made: {error.strerror}") from error
    return PrivateFolder(path).path


def folder_of(graph: str) -> Path:
    """Return the run folder of a graph, or of a part `graph@host`; raises `RunError`."""
    if not is_run_name(graph):
        raise RunError(f"expected the name of a graph, got {graph[:80]!r}")
    return base() / graph


def check_addresses(folder: Path, names: Iterable[str]) -> None:
    """Raise `RunError` if the socket path of one of these nodes or processes would be too long."""
    longest = max((folder / f"{name}.{NEWEST_EPOCH}.sock" for name in names), key=_length)
    if _length(longest) > LONGEST_ADDRESS:
        raise RunError(
            f"{longest}: expected up to {LONGEST_ADDRESS} bytes, as the address of a unix socket "
            f"has, got {_length(longest)}; set TMPDIR to a shorter folder"
        )


def is_run_name(text: str) -> bool:
    """Whether a text is a graph's name or `graph@host`.

    >>> is_run_name("tracking"), is_run_name("trio@sensor"), is_run_name("../x"), is_run_name("a@")
    (True, True, False, False)
    """
    return all(is_name(part) for part in text.split("@", 1))


def running() -> dict[str, dict[str, Any]]:
    """Return the facts of every running graph of this user, by name."""
    found = {}
    for folder in run_folders():
        lock = locked(folder.path, fcntl.LOCK_SH)  # shared among readers
        if lock is not None:
            os.close(lock)
        elif facts := noted(folder):
            found[folder.path.name] = facts
    return found


def run_folders() -> Iterator[PrivateFolder]:
    """Yield the run folders of this user, sorted by name; ignore anything else there."""
    parent = base()
    for name in sorted(os.listdir(parent)):
        if is_run_name(name):
            with contextlib.suppress(RunError):  # a file, a link, or already gone
                yield PrivateFolder(parent / name)


def noted(folder: PrivateFolder) -> dict[str, Any]:
    """Return the facts of a run; empty if they are missing or invalid."""
    try:
        facts = _READ.decode(folder.read(FACTS, MOST_FACTS_BYTES))
    except (OSError, msgspec.MsgspecError, ValueError, RecursionError):
        return {}
    names = [facts.graph, *facts.pids, *facts.restarts, *facts.crashes, *facts.gone]
    names += [name for n in facts.nodes for name in (n.name, n.process)]
    if not all(map(is_name, names)) or not RUN_ID.fullmatch(facts.run):
        return {}
    found: dict[str, Any] = msgspec.to_builtins(facts)
    return found


def _length(path: Path) -> int:
    return len(os.fsencode(path))


def memory_of(facts: dict[str, Any]) -> PrivateFolder:
    """Return the memory folder of a run by its facts; raises `RunError` when it is gone."""
    return PrivateFolder(path_of(facts["run"]))


def locked(folder: Path, kind: int = fcntl.LOCK_EX, *, create: bool = False) -> int | None:
    """Lock a folder; return None if it is locked already. Raises `OSError` only with `create`."""
    path = folder / LOCK
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | (os.O_CREAT if create else 0)
    try:
        handle = os.open(path, flags, 0o600)
    except OSError:
        if create and folder.is_dir():
            raise
        return None
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(handle), path.stat()):
            return handle
    except (BlockingIOError, FileNotFoundError):
        pass  # another process locked or removed it meanwhile
    os.close(handle)
    return None
