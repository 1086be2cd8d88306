"""Frame pools: arrays shared between processes without a copy, leased by kernel locks.

A pool is one tmpfs file: a header page with a generation counter per slot, then page-aligned slots.
The writer holds an exclusive open-file-description lock on a slot's byte while it fills it and a
shared one until its readers had their chance; a reader holds a shared lock while any numpy view of
the slot lives. The kernel drops the locks of a dead process, so nobody can leak a slot.

A pool never changes its size: bigger messages get a new file, named in their descriptor. The file
outlives its writer; whoever started the graph removes it.
"""

import contextlib
import fcntl
import math
import mmap
import os
import re
import secrets
import struct
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.errors import MessageError, PoolExhausted, RunError

PAGE_BYTES = 4096
MAGIC = 0x31_4C4F4F_50564F46
MAX_SLOTS = 480  # generation counters fit into the header page
_HEADER_WORDS = 4  # magic, pool id, slots, slot bytes


class SlotRef(NamedTuple):
    """Where a message's arrays lie; travels in its descriptor."""

    file: str
    pool_id: int
    slot: int
    generation: int
    nbytes: int


class Lease:
    """A slot being written: numpy memory, then a descriptor. Give it back with `abandon`."""

    def __init__(self, pool: "_File", slot: int, generation: int) -> None:
        self.pool, self.slot, self.generation = pool, slot, generation
        self.used_bytes = 0
        self._given: list[tuple[NDArray[Any], int]] = []

    def array(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any] | None:
        """The next piece of the slot as an array, or None when it does not fit."""
        kind = np.dtype(dtype)
        nbytes = math.prod(shape) * kind.itemsize
        first = -(-self.used_bytes // 64) * 64
        if first + nbytes > self.pool.slot_bytes:
            return None
        self.used_bytes = first + nbytes
        start = self.pool.start(self.slot) + first
        memory = self.pool.memory
        array = np.frombuffer(memory, kind, nbytes // kind.itemsize, start).reshape(shape)
        self._given.append((array, first))
        return array

    def offset_of(self, array: NDArray[Any]) -> int | None:
        """Offset of a contiguous array within this slot; None when it lies elsewhere."""
        for given, first in self._given:
            if given is array:
                return first
        if not array.flags.c_contiguous:
            return None
        address = array.__array_interface__["data"][0]
        offset = address - self.pool.address - self.pool.start(self.slot)
        inside = offset >= 0 and offset + array.nbytes <= self.pool.slot_bytes
        return int(offset) if inside else None

    def ref(self) -> SlotRef:
        """The descriptor of what was written."""
        pool = self.pool
        return SlotRef(pool.name, pool.pool_id, self.slot, self.generation, self.used_bytes)


class PoolWriter:
    """The writing end of one output port.

    `free` is asked about every written slot, oldest first, with the ordinal that `publish` was
    told: True when no reader can still be on its way to it.
    """

    def __init__(self, folder: Path, stem: str, slots: int, free: Callable[[int], bool]) -> None:
        if not 1 <= slots <= MAX_SLOTS:
            raise RunError(f"{stem}: expected 1 to {MAX_SLOTS} slots, got {slots}")
        self._folder, self._stem, self._slots, self._free = folder, stem, slots, free
        self._file: _File | None = None
        self._held: dict[int, int] = {}  # slot -> ordinal of the message in it
        self._lent: set[int] = set()
        self._next = 0
        self._ahead: Lease | None = None

    def lease(self, nbytes: int) -> Lease:
        """A slot of at least `nbytes`; raises `PoolExhausted` when none is free right now."""
        ahead, self._ahead = self._ahead, None
        if ahead is not None and nbytes <= ahead.pool.slot_bytes:
            return ahead
        return self._lease(nbytes)

    def prepare(self) -> None:
        """Lease the next slot while there is time, if one is free: asking for it is then quick."""
        if self._ahead is None and self._file is not None:
            with contextlib.suppress(PoolExhausted):
                self._ahead = self._lease(0)

    def _lease(self, nbytes: int) -> Lease:
        if self._file is None or self._file.slot_bytes < nbytes:
            self._file = _reuse_or_create(self._folder, self._stem, self._slots, nbytes)
            self._held.clear()
            self._lent.clear()
        file = self._file
        for step in range(self._slots):
            slot = (self._next + step) % self._slots
            if slot in self._lent or (slot in self._held and not self._free(self._held[slot])):
                continue
            if file.lock(fcntl.F_WRLCK, slot):
                self._next = slot + 1
                self._held.pop(slot, None)
                self._lent.add(slot)
                generation = file.generations[slot] + 1
                file.generations[slot] = generation
                return Lease(file, slot, generation)
            if slot in self._held:  # a reader is in it: our own shared lock is no longer needed
                del self._held[slot]
                file.lock(fcntl.F_UNLCK, slot)
        raise PoolExhausted(f"{file.path.name}: all {self._slots} slots are leased")

    def publish(self, lease: Lease, ordinal: int) -> None:
        """From now on readers may come; must be called before the descriptor leaves."""
        lease.pool.lock(fcntl.F_RDLCK, lease.slot)
        if lease.pool is self._file:
            self._lent.discard(lease.slot)
            self._held[lease.slot] = ordinal

    def abandon(self, lease: Lease) -> None:
        """The slot is not going to be sent."""
        lease.pool.lock(fcntl.F_UNLCK, lease.slot)
        if lease.pool is self._file:
            self._lent.discard(lease.slot)


class PoolReader:
    """The reading end of one input port: descriptors in, read-only memory out."""

    def __init__(self, folder: Path, stem: str) -> None:
        self._folder = folder
        self._name = re.compile(re.escape(stem) + r"\.[0-9a-f]{8}")
        self._file: _File | None = None

    def take(self, ref: SlotRef) -> NDArray[np.uint8] | None:
        """The slot's bytes, leased while any view of them lives; None when it was reused.

        Raises `MessageError` when the descriptor does not fit the pool it names.
        """
        file = self._file
        if file is None or file.name != ref.file or file.pool_id != ref.pool_id:
            file = self._open(ref)
        if not (0 <= ref.slot < file.slots and 0 <= ref.nbytes <= file.slot_bytes):
            raise MessageError(f"{ref.file}: no slot {ref.slot} of {ref.nbytes} bytes")
        if not file.lock(fcntl.F_RDLCK, ref.slot):
            return None
        if file.generations[ref.slot] != ref.generation:
            if not file.views.get(ref.slot):
                file.lock(fcntl.F_UNLCK, ref.slot)
            return None
        bytes_ = np.frombuffer(file.memory, np.uint8, ref.nbytes, file.start(ref.slot))
        file.hold(ref.slot, bytes_)
        return bytes_

    @property
    def pinned(self) -> int:
        """Slots that views of this reader keep from being reused."""
        return sum(1 for count in self._file.views.values() if count) if self._file else 0

    def _open(self, ref: SlotRef) -> "_File":
        if self._file is None or self._file.name != ref.file:
            if not self._name.fullmatch(ref.file):
                raise MessageError("a descriptor names a file that is no pool of this port")
            self._file = _File(self._folder / ref.file, writable=False)
        if self._file.pool_id != ref.pool_id:
            raise MessageError(f"{ref.file}: expected pool {ref.pool_id}, got another")
        return self._file


class _File:
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


def remove_pools(folder: Path, prefix: str) -> int:
    """Delete every pool whose name begins with `prefix`; the number deleted."""
    found = list(folder.glob(f"{prefix}*"))
    for path in found:
        path.unlink(missing_ok=True)
    return len(found)


def _reuse_or_create(folder: Path, stem: str, slots: int, nbytes: int) -> _File:
    """A restarted writer goes on in its predecessor's file, so readers keep their mapping."""
    for path in folder.glob(f"{stem}.*"):
        try:
            file = _File(path, writable=True)
        except MessageError:
            continue
        if file.slots == slots and file.slot_bytes >= nbytes:
            return file
        path.unlink(missing_ok=True)  # outgrown; readers inside keep it alive until they leave
    return _create(folder, stem, slots, nbytes)


def _create(folder: Path, stem: str, slots: int, nbytes: int) -> _File:
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
    return _File(path, writable=True)
