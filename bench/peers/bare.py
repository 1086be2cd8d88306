"""The floor: shared memory and one byte string through a fifo, nothing guarded.

What it takes to write, be woken and read is what no bus can go below; its writing and reading
times are what the others' totals are compared with.
"""

import mmap
import os
import select
import struct
from pathlib import Path

import numpy as np

from bench.peers.ruler import IDLE_S, PAGE_BYTES, RING, Bytes, Job, Reader, Writer, contest, duet


def produce(job: Job) -> None:
    """Fill the slots in turn; say which number is there."""
    slots, writer = _slots(job), Writer(job)
    bell = os.open(Path(job.folder, "bell"), os.O_WRONLY)
    for seq in writer.turns():
        writer.write(slots[seq % RING], seq)
        os.write(bell, struct.pack("q", seq))
    writer.save()


def consume(job: Job) -> None:
    """Read each as it is told."""
    path = Path(job.folder, "bell")
    os.mkfifo(path)
    slots, reader = _slots(job), Reader(job)
    bell = os.open(path, os.O_RDWR)  # also for writing: no end of file before the producer comes
    reader.ready()
    while not reader.over():
        if select.select([bell], [], [], IDLE_S)[0]:
            (seq,) = struct.unpack("q", os.read(bell, 8))
            reader.read(slots[seq % RING], seq)
    reader.save()


def _slots(job: Job) -> list[Bytes]:
    stride = -(-job.size_bytes // PAGE_BYTES) * PAGE_BYTES
    handle = os.open(Path(job.folder, "slots"), os.O_RDWR | os.O_CREAT, 0o600)
    os.ftruncate(handle, stride * RING)
    memory = np.frombuffer(mmap.mmap(handle, stride * RING), np.uint8)
    os.close(handle)
    return [memory[k * stride :][: job.size_bytes] for k in range(RING)]


if __name__ == "__main__":
    contest("bare", ("numpy",), duet(__spec__.name), produce=produce, consume=consume)
