"""End the processes that a node started, together with the node, and no others.

A node leads a process group, which ends with it. A process that left the group by its own session
is identified by a tag in its environment, inherited from the node; nothing reads the tag as
configuration. A process without tag and group is found by descent (`pipeline.process_tree`,
`pipeline.run.reaper`).
"""

import contextlib
import logging
import os
import secrets
import signal
import time
from collections.abc import Iterator

TAG_VARIABLE = "FOVEA_STARTED_BY"
ROUNDS = 5  # a process may start another while they are listed
PAUSE_S = 0.01
log = logging.getLogger(__name__)


def new_tag(run_id: str) -> str:
    """Return a tag for one instance of a node; tags of a run begin with the run's id."""
    return f"{run_id}{secrets.token_hex(8)}"


def end_group(leader: int) -> None:
    """Kill a process group whose leader is not reaped, so that its id is still valid."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)


def end_tagged(prefix: str) -> int:
    """Kill every process of this user whose tag has a prefix; return how many there were.

    The prefix is the tag of an instance or the id of a whole run. This process is never killed.
    """
    ended: set[int] = set()
    for _ in range(ROUNDS if prefix else 0):
        try:
            found = list(tagged(prefix))
        except OSError as error:
            log.warning("cannot search for processes that nodes started: %s", error)
            break
        for pid in found:
            _kill(pid, prefix)
        ended.update(found)
        if not found:
            break
        time.sleep(PAUSE_S)
    return len(ended)


def tagged(prefix: str) -> Iterator[int]:
    """Yield the other processes of this user whose tag has a prefix."""
    own_pid, own_uid = os.getpid(), os.getuid()
    with os.scandir("/proc") as entries:
        pids = [int(entry.name) for entry in entries if entry.name.isdecimal()]
    for pid in pids:
        if pid != own_pid and _uid(pid) == own_uid and _carries(pid, prefix):
            yield pid


def _uid(pid: int) -> int | None:
    try:
        return os.stat(f"/proc/{pid}").st_uid
    except OSError:
        return None


def _carries(pid: int, prefix: str) -> bool:
    """Whether a process has the tag; one that ends meanwhile, or is a zombie, has none."""
    wanted = f"{TAG_VARIABLE}={prefix}".encode()
    try:
        with open(f"/proc/{pid}/environ", "rb", buffering=0) as file:
            entries = file.readall() or b""
    except OSError:
        return False
    return entries.startswith(wanted) or b"\0" + wanted in entries


def _kill(pid: int, prefix: str) -> None:
    """Kill a process with the tag, never a later one with the same pid."""
    try:
        handle = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    except OSError:  # an old kernel, or no descriptor left
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGKILL)
        return
    try:
        if _carries(pid, prefix):
            with contextlib.suppress(OSError):
                signal.pidfd_send_signal(handle, signal.SIGKILL)
    finally:
        os.close(handle)
