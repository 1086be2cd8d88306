"""Reads a frame pool without ever keeping a slot from its writer: for parts that nothing waits for.

A `PoolReader` holds a slot by a lock while it is looked at; if its process is stopped, it holds the
slot for as long. A tap copies without a lock, and asks afterwards whether the writer has begun to
write the slot anew meanwhile: then what was copied may be torn, and counts as overwritten.
"""

import fcntl
import os
import struct

import numpy as np
from numpy.typing import NDArray

from pipeline.bus.pool import PoolReader, SlotRef
from pipeline.bus.pool_file import PoolFile

_LOCK = struct.Struct("hhqqi")


class PoolTap(PoolReader):
    """Descriptors in, copies out; `pinned` is always 0."""

    def take(self, ref: SlotRef) -> NDArray[np.uint8] | None:
        """A read-only copy of the slot's bytes; None when it was reused."""
        file = self.file_of(ref)
        if file.generations[ref.slot] != ref.generation:
            return None
        bytes_ = np.frombuffer(file.memory, np.uint8, ref.nbytes, file.start(ref.slot)).copy()
        # the writer locks a slot before it counts the generation, and that before it writes
        if _is_written(file, ref.slot) or file.generations[ref.slot] != ref.generation:
            return None
        bytes_.flags.writeable = False
        return bytes_


def _is_written(file: PoolFile, slot: int) -> bool:
    """Whether a writer has the slot to itself; asking keeps nobody from it."""
    request = _LOCK.pack(fcntl.F_RDLCK, os.SEEK_SET, slot, 1, 0)
    kind = _LOCK.unpack(fcntl.fcntl(file.handle, fcntl.F_OFD_GETLK, request))[0]
    return bool(kind != fcntl.F_UNLCK)
