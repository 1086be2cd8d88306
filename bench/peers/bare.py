"""Lower bound: a shared mapping and a few bytes through a fifo, without any protection.

It measures waking up and reading memory that another core wrote; no bus can be faster.
"""

import mmap
import os
import select
import struct
from pathlib import Path

import numpy as np

from bench.peers.ruler import Bytes, Meter, Task, Writer, contestant, two_processes

SLOTS = 8
POLL_S = 0.1
PAGE_BYTES = 4096


def receive(task: Task) -> None:
    """Run the receiving side."""
    meter = Meter(task)
    path = task.folder / "bell"
    os.mkfifo(path)
    slots = mapped(task)
    bell = os.open(path, os.O_RDWR)  # also for writing: no end of file before a sender opens it
    meter.ready()
    while not meter.finished:
        if select.select([bell], [], [], POLL_S)[0]:
            (number,) = struct.unpack("q", os.read(bell, 8))
            meter.take(slots[number % SLOTS])
    meter.save()


def send(task: Task) -> None:
    """Run the sending side."""
    writer = Writer(task)
    slots = mapped(task)
    memory_file(task).unlink()  # the receiver has mapped it
    bell = os.open(task.folder / "bell", os.O_WRONLY)
    for number in writer.paced():
        writer.write(slots[number % SLOTS], number)
        os.write(bell, struct.pack("q", number))
    writer.save()


def mapped(task: Task) -> list[Bytes]:
    """Return the slots, which are the same memory in both processes."""
    stride = -(-task.nbytes // PAGE_BYTES) * PAGE_BYTES
    handle = os.open(memory_file(task), os.O_RDWR | os.O_CREAT, 0o600)
    os.ftruncate(handle, stride * SLOTS)
    memory = np.frombuffer(mmap.mmap(handle, stride * SLOTS), np.uint8)
    os.close(handle)
    return [memory[k * stride :][: task.nbytes] for k in range(SLOTS)]


def memory_file(task: Task) -> Path:
    """Return a file in memory: a disk's pages are written back and made read-only meanwhile."""
    return Path("/dev/shm", task.folder.name)


if __name__ == "__main__":
    contestant("bare", "numpy", two_processes("bare"), {"receive": receive, "send": send})
