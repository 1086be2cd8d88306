"""Find and remove leftovers of killed runs: files and processes.

Only fovea's own are removed: names must match the patterns below, files must belong to this user
and be in a private folder, and processes must carry the id of a dead run.
"""

import contextlib
import fcntl
import os
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

from pipeline.errors import RunError
from pipeline.naming import GRAMMAR
from pipeline.private_folder import PrivateFolder
from pipeline.process_tree import descendants, end
from pipeline.run.descendants import end_tagged
from pipeline.run.memory_folder import MEMORY, RUN_ID, MemoryFolder, abandoned, path_of
from pipeline.run.rundir import LOCK, locked, noted, run_folders

KEEP_LOGS_S = 7 * 86400.0  # of graphs that have ended
NODE_MODULE = "pipeline.node.process"  # the module of every node process
_RUN_FILES = re.compile(
    rf"run\.json(\.part)?|clocks|{GRAMMAR}(\.\d+)?\.sock(\.lock)?|{GRAMMAR}\.\d+\.recv"
    rf"|{GRAMMAR}\.live(\.part)?"
)
_DETACHED = re.compile(r"run\.out(\.old)?|(detached|report)\.json(\.part)?")
_LOGS = re.compile(rf"{GRAMMAR}(\.stderr)?\.log(\.old)?|{_DETACHED.pattern}")


def cleanup() -> None:
    """Remove leftovers of killed supervisors: processes, shared memory, sockets, old logs."""
    clean_memory()
    for folder in run_folders():
        lock = locked(folder.path)
        if lock is None:
            continue
        try:
            clear(folder)
            if time.time() - os.fstat(lock).st_mtime > KEEP_LOGS_S:
                _forget(folder)
        finally:
            os.close(lock)


def clean_memory(memory: Path = MEMORY) -> None:
    """Remove the memory folders of killed runs, and their remaining processes."""
    for folder in abandoned(memory=memory):
        end_orphans(folder.run_id)
        folder.empty()


def leftovers() -> list[str]:
    """Return leftovers of killed supervisors except logs: graphs, and memory without a graph."""
    found = []
    for folder in run_folders():
        lock = locked(folder.path, fcntl.LOCK_SH)  # shared among readers
        if lock is not None:  # held while reading, so that no cleanup removes the folder
            if any(map(_RUN_FILES.fullmatch, folder.names())):
                found.append(folder.path.name)
            os.close(lock)
    return found + [str(m.path) for m in abandoned(fcntl.LOCK_SH) if not _only_unknown(m)]


def foreign(memory: Path = MEMORY) -> dict[str, list[str]]:
    """Return the files in folders of killed runs that no run makes: they and the folder stay."""
    folders = abandoned(fcntl.LOCK_SH, memory)
    return {str(each.path): names for each in folders if (names := each.unknown())}


def _only_unknown(folder: MemoryFolder) -> bool:
    names = folder.names()
    return bool(names) and len(folder.unknown()) == len(names)


def clear(folder: PrivateFolder) -> None:
    """Remove an ended run's files in its folder and in memory; its logs stay."""
    if run_id := noted(folder).get("run"):
        with contextlib.suppress(RunError):  # usually there is none
            memory = MemoryFolder(path_of(run_id))
            if memory.lock(fcntl.LOCK_EX):
                end_orphans(run_id)
                memory.empty()
    for name in folder.names():
        if _RUN_FILES.fullmatch(name):
            folder.remove(name)
    beside, stem = PrivateFolder(folder.path.parent), f"{folder.path.name}."
    for name in beside.names():  # sockets between hosts
        if name.startswith(stem) and _RUN_FILES.fullmatch(name.removeprefix(stem)):
            beside.remove(name)


def forget_detached(folder: PrivateFolder) -> None:
    """Remove the record of the last detached run, because another run begins."""
    for name in folder.names():
        if _DETACHED.fullmatch(name):
            folder.remove(name)


def end_orphans(run_id: str) -> None:
    """End the processes of a dead run, as a frozen node cannot end by itself."""
    for process, of in node_processes():
        if of == run_id:
            with contextlib.suppress(psutil.Error):  # it has just ended
                process.send_signal(signal.SIGSTOP)  # a stopped process starts no other
                end(descendants(process.pid))
                process.send_signal(signal.SIGKILL)
    end_tagged(run_id)  # and what they had started


def node_processes() -> Iterator[tuple[psutil.Process, str]]:
    """Yield the node processes of this user, each with the id of its run."""
    for process in psutil.process_iter(["cmdline", "uids"]):
        words, uids = process.info["cmdline"] or [], process.info["uids"]
        if NODE_MODULE not in words or uids is None or uids.effective != os.geteuid():
            continue
        after = words[words.index(NODE_MODULE) + 1 :]
        if after and RUN_ID.fullmatch(after[0]):
            yield process, after[0]


def logs_of(folder: Path) -> list[str]:
    """Return the names of the log files in a run folder."""
    return [name for name in os.listdir(folder) if _LOGS.fullmatch(name)]


def _forget(folder: PrivateFolder) -> None:
    """Remove a run folder that is long unused, unless it contains foreign files."""
    for name in logs_of(folder.path):
        folder.remove(name)
    folder.remove(LOCK)
    folder.remove_itself()
