"""Ends what nodes leave behind when they die: an orphan of a node becomes a child of this process.

For processes that are fovea's own, the command line and the agent: a process of the user's that
runs a graph as a library goes on as the system made it.
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

ROUNDS = 20  # a killed process takes a moment to end
PAUSE_S = 0.005
log = logging.getLogger(__name__)


class Reaper:
    """Adopts orphans from now on; one for all supervisors of a process.

    A node leads a session of its own and no process can enter a session, so that every child of
    another session, but the nodes and what was there before, is an orphan of a node. The first
    process of a container gets the orphans of all others, too: there it waits for those that have
    ended and kills none.
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
        """That node was waited for."""
        with self._lock:
            self._nodes.discard(pid)

    def end(self) -> int:
        """Kill all orphans with their descendants, wait for them; returns how many there were."""
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
        """Wait for the orphans that have ended; returns how many there were."""
        ended = [pid for pid in process_tree.zombies(os.getpid()) if self._is_orphan(pid)]
        before = {member.pid for member in self._before}
        for pid in set(ended) - before:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, os.WNOHANG)
        return len(set(ended) - before)

    def _is_orphan(self, pid: int) -> bool:
        return pid not in self._nodes and session_of(pid) not in (0, os.getsid(0))
