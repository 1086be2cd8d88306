"""Kill orphans of dead nodes, which become children of this process.

Only for fovea's own processes, i.e. the command line and the agent; a user's process that runs a
graph as a library is not changed.
"""

import contextlib
import logging
import os
import subprocess
import threading
import time
from collections.abc import Callable

from pipeline import process_tree
from pipeline.process_tree import Member, session_of

ROUNDS = 20  # attempts, since a killed process takes a moment to end
PAUSE_S = 0.005
log = logging.getLogger(__name__)


class Reaper:
    """Adopts orphans; one instance serves all supervisors of a process.

    Each node leads its own session, and no process can enter an existing session. So every child
    in another session, except nodes and earlier children, is an orphan of a node. As the first
    process of a container, it also gets orphans of others: there it only reaps ended ones and
    kills none.
    """

    def __init__(self) -> None:
        self._only_of_nodes = os.getpid() != 1
        self._lock = threading.Lock()
        self._nodes: set[int] = set()
        self._before = set(process_tree.children(os.getpid()))
        process_tree.adopt_orphans()

    def start(self, node: Callable[[], "subprocess.Popen[bytes]"]) -> "subprocess.Popen[bytes]":
        """Start a node."""
        with self._lock:
            popen = node()
            self._nodes.add(popen.pid)
            return popen

    def forget(self, pid: int) -> None:
        """Remove a node that was reaped."""
        with self._lock:
            self._nodes.discard(pid)

    def end(self) -> int:
        """Kill all orphans with their descendants and reap them; return how many there were."""
        found: set[Member] = set()
        with self._lock:
            for _ in range(ROUNDS):
                orphans = self._orphans()
                found.update(orphans)
                process_tree.end(orphans)
                if not self._reap() and not orphans:
                    break
                time.sleep(PAUSE_S)
        return len(found)

    def _orphans(self) -> list[Member]:
        return [
            member
            for member in process_tree.children(os.getpid())
            if self._only_of_nodes and member not in self._before and self._is_orphan(member.pid)
        ]

    def _reap(self) -> int:
        """Reap ended orphans; return how many there were."""
        ended = [pid for pid in process_tree.zombies(os.getpid()) if self._is_orphan(pid)]
        before = {member.pid for member in self._before}
        for pid in set(ended) - before:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, os.WNOHANG)
        return len(set(ended) - before)

    def _is_orphan(self, pid: int) -> bool:
        return pid not in self._nodes and session_of(pid) not in (0, os.getsid(0))
