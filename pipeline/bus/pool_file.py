"""File of a frame pool: a header page with a generation per slot, page-aligned slots, locks.

Pool files are in the private memory folder of a run: another user can neither read nor truncate
them, nor create a file of that name first.
"""

import contextlib
import fcntl
import mmap
import os
import re
import secrets
import struct
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MessageError, RunError
from pipeline.private_folder import PrivateFolder

PAGE_BYTES = 4096
MAGIC = 0x31_4C4F4F_50564F46
MAX_SLOTS = 480  # generation counters fit into the header page
_HEADER_WORDS = 4  # magic, pool id, slots, slot bytes
_SUFFIX = re.compile(r"\.[0-9a-f]{8}")


class PoolFile:
    """A mapped pool file."""

    def __init__(self, folder: PrivateFolder, name: str, *, writable: bool) -> None:
        self.name = name
        try:
            self.handle = folder.open(name, writable=writable)
        except OSError as error:
            raise MessageError(f"{name}: cannot be opened: {error.strerror}") from error
        weakref.finalize(self, os.close, self.handle).atexit = False
        size = os.fstat(self.handle).st_size
        protection = mmap.PROT_READ | (mmap.PROT_WRITE if writable else 0)
        try:
            self.memory = mmap.mmap(self.handle, size, mmap.MAP_SHARED, protection)
            words = np.frombuffer(self.memory, np.uint64, _HEADER_WORDS + MAX_SLOTS)
        except (ValueError, OSError) as error:
            raise MessageError(f"{name}: not a frame pool") from error
        magic, self.pool_id, self.slots, self.slot_bytes = (int(w) for w in words[:_HEADER_WORDS])
        if magic != MAGIC or size < PAGE_BYTES + self.slots * self.slot_bytes:
            raise MessageError(f"{name}: not a frame pool")
        self.generations = memoryview(self.memory).cast("Q")[
            _HEADER_WORDS : _HEADER_WORDS + MAX_SLOTS
        ]
        self.address = words.__array_interface__["data"][0]
        self.views: dict[int, int] = {}  # the locks do not nest: count the views
        self._watched: dict[int, tuple[weakref.ref[Any], int]] = {}
        self._requests: dict[tuple[int, int], bytes] = {}

    def start(self, slot: int) -> int:
        """Return the offset of a slot in the file, in bytes."""
        return PAGE_BYTES + slot * self.slot_bytes

    def lock(self, kind: int, slot: int) -> bool:
        """Set or release this handle's lock on a slot; return False if another lock conflicts."""
        request = self._requests.get((kind, slot))
        if request is None:
            request = struct.pack("hhqqi", kind, os.SEEK_SET, slot, 1, 0)
            self._requests[kind, slot] = request
        try:
            fcntl.fcntl(self.handle, fcntl.F_OFD_SETLK, request)
        except (BlockingIOError, PermissionError):
            return False
        return True

    def hold(self, slot: int, view: NDArray[np.uint8]) -> None:
        """Hold the shared lock until the view and all views derived from it are gone."""
        self.views[slot] = self.views.get(slot, 0) + 1
        watch = weakref.ref(view, self._let_go)
        self._watched[id(watch)] = (watch, slot)

    def _let_go(self, watch: "weakref.ref[Any]") -> None:
        _, slot = self._watched.pop(id(watch))
        left = self.views[slot] - 1
        self.views[slot] = left
        if not left:
            self.lock(fcntl.F_UNLCK, slot)


def pools_of(folder: PrivateFolder, stem: str) -> Iterator[PoolFile]:
    """Open the pools of a port, of whichever writer, one after another."""
    for name in folder.names():
        if is_pool(name, stem):
            with contextlib.suppress(MessageError):  # removed meanwhile, or no pool
                yield PoolFile(folder, name, writable=True)


def is_pool(name: str, stem: str) -> bool:
    """Whether a file name is that of a pool of a port.

    >>> is_pool("eye.out.0123abcd", "eye.out"), is_pool("eye.out.0123abcd.part", "eye.out")
    (True, False)
    """
    return _SUFFIX.fullmatch(name.removeprefix(stem)) is not None and name.startswith(stem)


def pool_bytes(slots: int, nbytes: int) -> int:
    """Return the size of a pool's file whose messages have that many bytes.

    >>> pool_bytes(4, 5000)
    36864
    """
    return PAGE_BYTES + slots * _slot_bytes(nbytes)


def _slot_bytes(nbytes: int) -> int:
    return -(-max(nbytes, 1) // PAGE_BYTES) * PAGE_BYTES


def create(folder: PrivateFolder, stem: str, slots: int, nbytes: int) -> PoolFile:
    """Create a pool; raises `RunError` without room in memory."""
    slot_bytes, size = _slot_bytes(nbytes), pool_bytes(slots, nbytes)
    name = f"{stem}.{secrets.token_hex(4)}"
    part = f"{name}.part"
    handle = folder.create(part)
    try:
        os.posix_fallocate(handle, 0, size)  # a lack of memory is an error now, not a SIGBUS later
        header = np.array([MAGIC, secrets.randbits(63), slots, slot_bytes], np.uint64)
        os.pwrite(handle, header.tobytes(), 0)
    except OSError as error:
        folder.remove(part)
        raise RunError(
            f"{folder.path}: no room for a frame pool of {size / 1e6:.0f} MB ({slots} x "
            f"{slot_bytes}): {error.strerror}"
        ) from error
    finally:
        os.close(handle)
    folder.rename(part, name)
    return PoolFile(folder, name, writable=True)
