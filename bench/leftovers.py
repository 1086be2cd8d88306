"""Checks after any number of faults: accounts add up, no files or processes are left."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.run.leftovers import node_processes
from pipeline.run.memory_folder import path_of
from pipeline.run.rundir import folder_of, running
from pipeline.run.supervisor import Supervisor


@dataclass(frozen=True)
class Traces:
    """Where a run may leave files and processes, recorded while it runs."""

    folder: Path
    run_id: str

    @staticmethod
    def of(graph: str) -> "Traces":
        """Return the traces of a running graph."""
        return Traces(folder_of(graph), str(running()[graph]["run"]))

    def files(self) -> list[str]:
        """Return leftover shared memory and sockets, after the run's end; logs are to stay."""
        memory = path_of(self.run_id)
        return sorted(
            [*map(str, memory.glob("*") if memory.exists() else ()), *leftover_files(self.folder)]
        )

    def orphans(self) -> list[int]:
        """Return the ids of processes that run after the run's end."""
        return [process.pid for process, run_id in node_processes() if run_id == self.run_id]


def leftover_files(folder: Path) -> list[str]:
    """Return the names of all files below a folder, except logs and locks, which are to stay."""
    return sorted(
        path.name
        for path in folder.rglob("*")
        if path.name != "lock" and path.suffix not in (".log", ".old") and not path.is_dir()
    )


def unbalanced(edges: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return edges whose account does not add up to what was offered.

    >>> edge = {"from": "a", "to": "b", "offered": 5, "delivered": 3, "dropped": {"gap": 1},
    ...         "in_flight": 0, "lost_in_crash": 1}
    >>> unbalanced([edge]), unbalanced([edge | {"lost_in_crash": 0}])
    ([], ['a -> b'])
    """
    return [
        f"{e['from']} -> {e['to']}"
        for e in edges
        if e["offered"]
        != e["delivered"] + sum(e["dropped"].values()) + e["in_flight"] + e["lost_in_crash"]
        or e["in_flight"]
    ]


def run_for(supervisor: Supervisor, seconds: float) -> None:
    """Let the graph run for so many seconds."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        supervisor.tick()
