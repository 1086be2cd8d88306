"""The graphs that this user has deployed, and their hosts: a file that commands share."""

import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import msgspec

from pipeline.errors import RunError
from pipeline.fleet.hosts import Hosts
from pipeline.whole_file import write_whole


def remembered() -> dict[str, Hosts]:
    """Return the graphs that this user has deployed, and their hosts; raises `RunError`."""
    path = _memory()
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Hosts])
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise RunError(f"{path}: cannot be read: {error.strerror}") from error
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:  # no UTF-8, or too deep
        raise RunError(f"{path}: not what `fovea up` wrote: {error}") from error


def remember(graph: str, hosts: Hosts) -> None:
    """Store where a graph was deployed."""
    with _alone():
        _write({**remembered(), graph: hosts})


def forget(graph: str) -> None:
    """Remove the record of a graph that was taken down."""
    with _alone():
        _write({g: h for g, h in remembered().items() if g != graph})


def _memory() -> Path:
    folder = Path.home() / ".local" / "state" / "fovea"  # persistent, as on the hosts
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder / "fleet.json"


@contextmanager
def _alone() -> Iterator[None]:
    """Hold an exclusive lock for a read-modify-write; it ends with this process."""
    with _memory().with_suffix(".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _write(graphs: Mapping[str, Hosts]) -> None:
    document = {
        g: {"points": dict(h.points), "credentials": h.credentials, "nodes": dict(h.nodes)}
        for g, h in graphs.items()
    }
    write_whole(_memory(), json.dumps(document))
