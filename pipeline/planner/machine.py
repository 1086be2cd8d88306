"""What the machine has for a graph: cores, shared memory, memory."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import psutil

from pipeline.cores import available_cores
from pipeline.run.memory_folder import MEMORY


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Sizes in bytes; 0: there is none, or it is not known."""

    cores: float
    shared: int  # of the file system that holds the frame pools
    shared_free: int
    memory: int
    memory_free: int


def this_machine(shared: Path = MEMORY) -> Machine:
    """Return what this machine has now."""
    memory = psutil.virtual_memory()
    try:
        room = shutil.disk_usage(shared)
        size, free = room.total, room.free
    except OSError:
        size = free = 0
    return Machine(
        cores=available_cores(), shared=size, shared_free=free, memory=memory.total,
        memory_free=memory.available,
    )  # fmt: skip
