"""Find and end processes by descent, which a process cannot change as it can group or session.

The children of a dead process pass to the nearest ancestor that adopts orphans, otherwise to the
first process of the system; from then on they are no longer descendants.
"""

import contextlib
import ctypes
import os
import signal
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import psutil

PR_SET_CHILD_SUBREAPER = 36
ROUNDS = 50  # a process may start another while they are listed
_STATE, _PARENT, _SESSION, _STARTED = 0, 1, 3, 19  # fields after the name in /proc/PID/stat


@dataclass(frozen=True, slots=True)
class Member:
    """A process, distinguishable from a later one with the same pid."""

    pid: int
    started: int  # clock ticks after the start of the system


def adopt_orphans() -> bool:
    """Become the parent of orphaned descendants; False where the system does not support it."""
    try:
        adopted: int = ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    except (OSError, AttributeError):
        return False
    return adopted == 0


def children(pid: int) -> Iterator[Member]:
    """Yield the living children of a process."""
    for child in _child_ids(pid):
        stat = _stat(child)
        if stat and stat[_STATE] not in "ZX":
            yield Member(child, int(stat[_STARTED]))


def zombies(pid: int) -> Iterator[int]:
    """Yield the ended children of a process that were not waited for."""
    for child in _child_ids(pid):
        if (stat := _stat(child)) and stat[_STATE] == "Z":
            yield child


def session_of(pid: int) -> int:
    """Return the session id of a process; 0 when there is no such process."""
    stat = _stat(pid)
    return int(stat[_SESSION]) if stat else 0


def descendants(pid: int) -> set[Member]:
    """Return the living descendants of a process."""
    found: set[Member] = set()
    fresh = set(children(pid))
    while fresh:
        found |= fresh
        fresh = {below for member in fresh for below in children(member.pid)} - found
    return found


def lives(member: Member) -> bool:
    """Whether this very process is still alive."""
    stat = _stat(member.pid)
    return stat is not None and int(stat[_STARTED]) == member.started and stat[_STATE] not in "ZX"


def end(members: Iterable[Member]) -> int:
    """Kill processes and all their descendants; return how many there were.

    They are stopped first, because a stopped process cannot start another.
    """
    found: set[Member] = set()
    fresh = {member for member in members if lives(member)}
    for _ in range(ROUNDS):
        if not fresh:
            break
        for member in fresh:
            send(member, signal.SIGSTOP)
        found |= fresh
        fresh = {below for member in found for below in descendants(member.pid)} - found
    for member in found:
        send(member, signal.SIGKILL)
    return len(found)


def send(member: Member, number: signal.Signals) -> None:
    """Send a signal to this very process, never to a later one with the same pid."""
    try:
        handle = os.pidfd_open(member.pid)
    except ProcessLookupError:
        return
    except OSError:  # an old kernel, or no descriptor left
        if lives(member):
            with contextlib.suppress(OSError):
                os.kill(member.pid, number)
        return
    try:
        if lives(member):
            with contextlib.suppress(OSError):
                signal.pidfd_send_signal(handle, number)
    finally:
        os.close(handle)


def _child_ids(pid: int) -> list[int]:
    """Return the children of all threads of a process; none when there is no such process."""
    found: list[int] = []
    try:
        for thread in os.listdir(f"/proc/{pid}/task"):
            path = f"/proc/{pid}/task/{thread}/children"
            with contextlib.suppress(FileNotFoundError, ProcessLookupError), open(path) as file:
                found += map(int, file.read().split())
        if found or os.path.exists(f"/proc/{pid}/task/{pid}/children"):
            return found
        return [child.pid for child in psutil.Process(pid).children()]  # a kernel without that file
    except (OSError, psutil.Error):
        return found


def _stat(pid: int) -> list[str] | None:
    """Return the fields of /proc/PID/stat after the name; None when there is no such process."""
    try:
        with open(f"/proc/{pid}/stat", "rb", buffering=0) as file:
            text = file.readall() or b""
    except OSError:
        return None
    return text.rpartition(b")")[2].decode().split() or None
