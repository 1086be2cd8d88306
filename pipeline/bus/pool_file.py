"""The file of a frame pool: a header page with a generation per slot, page-aligned slots, locks."""

import fcntl
import mmap
import os
import secrets
import struct
import weakref
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MessageError, RunError

PAGE_BYTES = 4096
MAGIC = 0x31_4C4F4F_50564F46
MAX_SLOTS = 480  # generation counters fit into the header page
_HEADER_WORDS = 4  # magic, pool id, slots, slot bytes


class PoolFile:
    """A mapped pool file."""

    def __init__(self, path: Path, *, writable: bool) -> None:
        self.path, self.name = path, path.name
        try:
            self.handle = os.open(path, os.O_RDWR if writable else os.O_RDONLY)
        except OSError as error:
            raise MessageError(f"{path.name}: cannot be opened: {error.strerror}") from error
        weakref.finalize(self, os.close, self.handle).atexit = False
        size = os.fstat(self.handle).st_size
        protection = mmap.PROT_READ | (mmap.PROT_WRITE if writable else 0)
        try:
            self.memory = mmap.mmap(self.handle, size, mmap.MAP_SHARED, protection)
            words = np.frombuffer(self.memory, np.uint64, _HEADER_WORDS + MAX_SLOTS)
        except (ValueError, OSError) as error:
            raise MessageError(f"{path.name}: not a frame pool") from error
        magic, self.pool_id, self.slots, self.slot_bytes = (int(w) for w in words[:_HEADER_WORDS])
        if magic != MAGIC or size < PAGE_BYTES + self.slots * self.slot_bytes:
            raise MessageError(f"{path.name}: not a frame pool")
        self.generations = memoryview(self.memory).cast("Q")[
            _HEADER_WORDS : _HEADER_WORDS + MAX_SLOTS
        ]
        self.address = words.__array_interface__["data"][0]
        self.views: dict[int, int] = {}  # open-file-description locks do not nest: count views
        self._watched: dict[int, tuple[weakref.ref[Any], int]] = {}
        self._requests: dict[tuple[int, int], bytes] = {}

    def start(self, slot: int) -> int:
        """Offset of a slot in the file."""
        return PAGE_BYTES + slot * self.slot_bytes

    def lock(self, kind: int, slot: int) -> bool:
        """Set or drop this handle's lock on a slot; False when somebody else's is in the way."""
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
        """Keep the shared lock until the view, and every view of it, is gone."""
        self.views[slot] = self.views.get(slot, 0) + 1
        watch = weakref.ref(view, self._let_go)
        self._watched[id(watch)] = (watch, slot)

    def _let_go(self, watch: "weakref.ref[Any]") -> None:
        _, slot = self._watched.pop(id(watch))
        left = self.views[slot] - 1
        self.views[slot] = left
        if not left:
            self.lock(fcntl.F_UNLCK, slot)


def reuse_or_create(folder: Path, stem: str, slots: int, nbytes: int) -> PoolFile:
    """A restarted writer goes on in its predecessor's file, so readers keep their mapping."""
    for path in folder.glob(f"{stem}.*"):
        try:
            file = PoolFile(path, writable=True)
        except MessageError:
            continue
        if file.slots == slots and file.slot_bytes >= nbytes:
            return file
        path.unlink(missing_ok=True)  # outgrown; readers inside keep it alive until they leave
    return _create(folder, stem, slots, nbytes)


def _create(folder: Path, stem: str, slots: int, nbytes: int) -> PoolFile:
    slot_bytes = -(-max(nbytes, 1) // PAGE_BYTES) * PAGE_BYTES
    size = PAGE_BYTES + slots * slot_bytes
    path = folder / f"{stem}.{secrets.token_hex(4)}"
    part = path.with_name(f"{path.name}.part")
    handle = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        os.posix_fallocate(handle, 0, size)  # a full disk is an error now, not a SIGBUS later
        header = np.array([MAGIC, secrets.randbits(63), slots, slot_bytes], np.uint64)
        os.pwrite(handle, header.tobytes(), 0)
    except OSError as error:
        part.unlink()
        raise RunError(
            f"{folder}: no room for a frame pool of {size / 1e6:.0f} MB ({slots} x {slot_bytes}): "
            f"{error.strerror}"
        ) from error
    finally:
        os.close(handle)
    part.rename(path)
    return PoolFile(path, writable=True)
