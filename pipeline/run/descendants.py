"""Ends what a node started together with the node, and nothing of anybody else.

A node leads a process group, which ends with it. What left the group by a session of its own is
known by an entry of its environment, which the node was given and its children inherit; nothing
reads the entry as configuration. A process that clears its environment and its group is found by
descent (`pipeline.process_tree`, `pipeline.run.reaper`).
"""

import contextlib
import logging
import os
import secrets
import signal
import time
from collections.abc import Iterator

TAG_VARIABLE = "FOVEA_STARTED_BY"
ROUNDS = 5  # one that is found may just have started another
PAUSE_S = 0.01
log = logging.getLogger(__name__)


def new_tag(run_id: str) -> str:
    """Return a tag for one instance of a node; tags of a run begin with the run's id."""
    return f"{run_id}{secrets.token_hex(8)}"


def end_group(leader: int) -> None:
    """Kill a process group whose leader has not been reaped: its number is still its own."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)


def end_tagged(prefix: str) -> int:
    """Kill every process of this user whose tag begins so; return how many there were.

    With the tag of an instance that is what it started, with the id of a run what the whole
    run did. This process is spared in any case.
    """
    ended: set[int] = set()
    for _ in range(ROUNDS if prefix else 0):
        try:
            found = list(tagged(prefix))
        except OSError as error:
            log.warning("what nodes started cannot be looked for: %s", error)
            break
        for pid in found:
            _kill(pid, prefix)
        ended.update(found)
        if not found:
            break
        time.sleep(PAUSE_S)
    return len(ended)


def tagged(prefix: str) -> Iterator[int]:
    """Yield the processes of this user, other than this one, whose tag begins so."""
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
    """Kill a process that carries the tag, not one that has got its number since."""
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
