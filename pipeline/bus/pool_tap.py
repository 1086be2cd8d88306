"""Read a frame pool without ever blocking its writer, for readers that nothing waits for.

A `PoolReader` locks a slot while it is read; if its process is stopped, the slot stays locked. A
tap copies without a lock and then checks whether the writer has begun to reuse the slot: in that
case the copy may be torn, and the message counts as overwritten.
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
        """Return a read-only copy of the slot's bytes; None when it was reused."""
        file = self.file_of(ref)
        if file.generations[ref.slot] != ref.generation:
            return None
        bytes_ = np.frombuffer(file.memory, np.uint8, ref.nbytes, file.start(ref.slot)).copy()
        # the writer first locks a slot, then increments the generation, then writes
        if _is_written(file, ref.slot) or file.generations[ref.slot] != ref.generation:
            return None
        bytes_.flags.writeable = False
        return bytes_


def _is_written(file: PoolFile, slot: int) -> bool:
    """Whether a writer holds the exclusive lock; the test itself takes no lock."""
    request = _LOCK.pack(fcntl.F_RDLCK, os.SEEK_SET, slot, 1, 0)
    kind = _LOCK.unpack(fcntl.fcntl(file.handle, fcntl.F_OFD_GETLK, request))[0]
    return bool(kind != fcntl.F_UNLCK)
