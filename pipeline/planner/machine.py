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
    limit = _limit(group)
    return Machine(
        cores=available_cores(group / "cpu.max"), shared_bytes=size, shared_free_bytes=free,
        memory_bytes=min(memory.total, limit or memory.total),
        memory_free_bytes=min(memory.available, limit or memory.available),
    )  # fmt: skip


def _limit(group: Path) -> int:
    """Return the memory limit of the control group in bytes; 0: none."""
    try:
        return int((group / "memory.max").read_text())
    except (OSError, ValueError):  # "max" is no limit
        return 0
