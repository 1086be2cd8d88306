"""What the machine has for a graph: cores, shared memory, memory."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import psutil

from pipeline.cores import available_cores
from pipeline.run.memory_folder import MEMORY


@dataclass(frozen=True, kw_only=True)
class Machine:
    """What there is; 0: none, or it is not known."""

    cores: float
    shared_bytes: int  # of the file system that holds the frame pools
    shared_free_bytes: int
    memory_bytes: int
    memory_free_bytes: int


def this_machine(shared: Path = MEMORY, group: Path = Path("/sys/fs/cgroup")) -> Machine:
    """Return what this machine, or the container that this process is in, has now."""
    memory = psutil.virtual_memory()
    try:
        room = shutil.disk_usage(shared)
        size, free = room.total, room.free
    except OSError:
        size = free = 0
    limit, used = _number(group / "memory.max"), _number(group / "memory.current")
    left = max(0, limit - used) if limit else memory.available
    return Machine(
        cores=available_cores(group / "cpu.max"), shared_bytes=size, shared_free_bytes=free,
        memory_bytes=min(memory.total, limit or memory.total),
        memory_free_bytes=min(memory.available, left),
    )  # fmt: skip


def _number(file: Path) -> int:
    """Return a figure of the control group; 0: none."""
    try:
        return int(file.read_text())
    except (OSError, ValueError):  # "max" is no limit
        return 0
