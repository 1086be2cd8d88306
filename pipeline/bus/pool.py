"""Frame pools: arrays shared between processes without a copy, leased by kernel locks.

A pool is one tmpfs file: a header page with a generation counter per slot, then page-aligned slots.
The writer holds an exclusive open-file-description lock on a slot's byte while it fills it and a
shared one until its readers had their chance; a reader holds a shared lock while any numpy view of
the slot exists. The kernel releases the locks of a dead process, so a crash cannot leak a slot.

A pool never changes its size: larger messages get a new file, named in their descriptor. The
outgrown file is removed when as many messages as it has slots have followed; before that a reader
may not have opened it yet. A file outlives its writer; the supervisor removes it with the memory
folder of the run.
"""

import contextlib
import fcntl
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.bus.pool_file import MAX_SLOTS, PoolFile, create, is_pool, pools_of
from pipeline.errors import MessageError, PoolExhausted, RunError
from pipeline.private_folder import PrivateFolder

AHEAD_BYTES = 1 << 20
ALIGN_BYTES = 64  # an array in a slot begins at a multiple of these
KEPT, SPARE, DONE = 0, 1, 2  # claims of readers on a slot


class SlotRef(NamedTuple):
    """The slot with a message's arrays, as its descriptor names it."""

    file: str
    pool_id: int
    slot: int
    generation: int
    nbytes: int


class Lease:
    """A slot being written: numpy memory, then a descriptor. `abandon` releases it."""

    def __init__(self, pool: PoolFile, slot: int, generation: int) -> None:
        self.pool, self.slot, self.generation = pool, slot, generation
        self.used_bytes = 0
        self._given: list[tuple[NDArray[Any], int]] = []

    def array(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any] | None:
        """Return the next part of the slot as an array; None when it does not fit."""
        kind = np.dtype(dtype)
        nbytes = math.prod(shape) * kind.itemsize
        first = -(-self.used_bytes // ALIGN_BYTES) * ALIGN_BYTES
        if first + nbytes > self.pool.slot_bytes:
            return None
        self.used_bytes = first + nbytes
        start = self.pool.start(self.slot) + first
        memory = self.pool.memory
        array = np.frombuffer(memory, kind, nbytes // kind.itemsize, start).reshape(shape)
        self._given.append((array, first))
        return array

    def offset_of(self, array: NDArray[Any]) -> int | None:
        """Return the offset (bytes) of a contiguous array in this slot; None if it is elsewhere."""
        for given, first in self._given:
            if given is array:
                return first
        if not array.flags.c_contiguous:
            return None
        address = array.__array_interface__["data"][0]
        offset = address - self.pool.address - self.pool.start(self.slot)
        # of an earlier lease of this slot, which a part may have kept, nothing is given out yet
        inside = offset >= 0 and offset + array.nbytes <= self.used_bytes
        return int(offset) if inside else None

    def ref(self) -> SlotRef:
        """Return the descriptor of the written slot."""
        pool = self.pool
        return SlotRef(pool.name, pool.pool_id, self.slot, self.generation, self.used_bytes)


class PoolWriter:
    """The writing end of one output port.

    `claim` maps the ordinal of a published slot to KEPT (a reader will still read it), SPARE (it
    may be overwritten) or DONE (no reader will come). Of the DONE slots the last written one is
    reused first: its pages are still in the TLB, which halves the time to write 9 MB. Of the SPARE
    ones the oldest is reused first.
    """

    def __init__(
        self, folder: PrivateFolder, stem: str, slots: int, claim: Callable[[int], int]
    ) -> None:
        if not 1 <= slots <= MAX_SLOTS:
            raise RunError(f"{stem}: expected 1 to {MAX_SLOTS} slots, got {slots}")
        self._folder, self._stem, self._slots, self._claim = folder, stem, slots, claim
        self._file: PoolFile | None = None
        self._held: dict[int, int] = {}  # slot -> ordinal of the message in it
        self._lent: set[int] = set()
        self._recent = list(range(slots))  # the last written slot comes first
        self._ahead: Lease | None = None
        # by name, with the locks they hold, and after how many more messages they are removed
        self._outgrown: dict[str, tuple[PoolFile, int]] = {}

    def lease(self, nbytes: int) -> Lease:
        """Lease a slot of at least `nbytes`; raises `PoolExhausted` when none is free now."""
        ahead, self._ahead = self._ahead, None
        if ahead is not None and nbytes <= ahead.pool.slot_bytes:
            return ahead
        return self._lease(nbytes)

    def prepare(self) -> None:
        """Lease a free slot ahead of time, if there is one, so that the next `lease` is fast.

        Not for large slots: waiting until the newest one is DONE gains more.
        """
        if self._ahead is None and self._file and self._file.slot_bytes <= AHEAD_BYTES:
            with contextlib.suppress(PoolExhausted):
                self._ahead = self._lease(0)

    def _lease(self, nbytes: int) -> Lease:
        if self._file is not None and self._file.slot_bytes < nbytes:
            self._outgrow(self._file)
        file = self._file = self._file or self._reuse_or_create(nbytes)
        for slot in self._candidates():
            if file.lock(fcntl.F_WRLCK, slot):
                self._held.pop(slot, None)
                self._lent.add(slot)
                generation = file.generations[slot] + 1
                file.generations[slot] = generation
                return Lease(file, slot, generation)
            if slot in self._held:  # a reader holds it: our own shared lock is no longer needed
                del self._held[slot]
                file.lock(fcntl.F_UNLCK, slot)
        raise PoolExhausted(f"{file.name}: all {self._slots} slots are leased")

    def _reuse_or_create(self, nbytes: int) -> PoolFile:
        """Return the predecessor's file, so that readers keep their mapping, or a new one.

        Of several the largest is the current one. Raises `RunError` without room for a new one.
        """
        files = [f for f in pools_of(self._folder, self._stem) if f.name not in self._outgrown]
        fitting = [f for f in files if f.slots == self._slots and f.slot_bytes >= nbytes]
        current = max(fitting, key=lambda file: file.slot_bytes, default=None)
        for file in files:
            if file is not current:
                self._outgrow(file)
        if current is not None:
            return current
        try:
            return create(self._folder, self._stem, self._slots, nbytes)
        except RunError:  # no room: what readers may still open is less than what they would lose
            if not self._outgrown:
                raise
            self._remove_outgrown(list(self._outgrown))
            return create(self._folder, self._stem, self._slots, nbytes)

    def _outgrow(self, file: PoolFile) -> None:
        """Keep a file until every reader of the messages in it had its chance, then remove it."""
        self._outgrown[file.name] = file, file.slots
        if file is self._file:
            self._file, self._ahead = None, None
            self._held.clear()
            self._lent.clear()

    def _count_down(self) -> None:
        """Remove the outgrown files that no reader needs any more, one message later."""
        for name, (file, left) in list(self._outgrown.items()):
            self._outgrown[name] = file, left - 1
            if not left:
                self._remove_outgrown([name])

    def _remove_outgrown(self, names: Sequence[str]) -> None:
        for name in names:
            del self._outgrown[name]
            self._folder.remove(name)

    def _candidates(self) -> Iterator[int]:
        spare = []
        for slot in self._recent:
            if slot in self._lent:
                continue
            ordinal = self._held.get(slot)
            claim = DONE if ordinal is None else self._claim(ordinal)
            if claim == DONE:
                yield slot
            elif claim == SPARE:
                spare.append(slot)
        yield from reversed(spare)

    def publish(self, lease: Lease, ordinal: int) -> None:
        """Open the slot for readers; must be called before the descriptor is sent."""
        lease.pool.lock(fcntl.F_RDLCK, lease.slot)
        if lease.pool is self._file:
            self._lent.discard(lease.slot)
            self._held[lease.slot] = ordinal
            self._recent.remove(lease.slot)
            self._recent.insert(0, lease.slot)
        else:  # lent before its file was outgrown: readers have as long for this message, too
            self._outgrow(lease.pool)
        if self._outgrown:
            self._count_down()

    def let_go(self) -> None:
        """While another process writes: release every slot that no reader needs."""
        if self._ahead is not None:
            self.abandon(self._ahead)
            self._ahead = None
        for slot, ordinal in list(self._held.items()):
            if self._file is not None and self._claim(ordinal) != KEPT:
                del self._held[slot]
                self._file.lock(fcntl.F_UNLCK, slot)

    def resize(self, slots: int) -> None:
        """Change the number of slots from the next message on; the old file stays readable."""
        if slots > self._slots and self._file is not None:
            self._outgrow(self._file)
        self._slots = max(slots, self._slots)
        self._recent = list(range(self._slots))

    def refresh(self) -> None:
        """Leave a file that another process has replaced by a larger one meanwhile."""
        file = self._file
        if file is not None and (
            not self._folder.has(file.name)
            or any(
                other.slot_bytes > file.slot_bytes
                for other in pools_of(self._folder, self._stem)
                if other.name not in self._outgrown
            )
        ):
            self._outgrow(file)

    def abandon(self, lease: Lease) -> None:
        """Release a slot that will not be sent."""
        lease.pool.lock(fcntl.F_UNLCK, lease.slot)
        if lease.pool is self._file:
            self._lent.discard(lease.slot)


class PoolReader:
    """The reading end of one input port: descriptors in, read-only memory out."""

    def __init__(self, folder: PrivateFolder, stem: str) -> None:
        self._folder, self._stem = folder, stem
        self._file: PoolFile | None = None

    def take(self, ref: SlotRef) -> NDArray[np.uint8] | None:
        """Return the slot's bytes, leased while any view of them exists; None when it was reused.

        Raises `MessageError` when the descriptor does not match the pool that it names.
        """
        file = self.file_of(ref)
        if not file.lock(fcntl.F_RDLCK, ref.slot):
            return None
        if file.generations[ref.slot] != ref.generation:
            if not file.views.get(ref.slot):
                file.lock(fcntl.F_UNLCK, ref.slot)
            return None
        bytes_ = np.frombuffer(file.memory, np.uint8, ref.nbytes, file.start(ref.slot))
        file.hold(ref.slot, bytes_)
        return bytes_

    def file_of(self, ref: SlotRef) -> PoolFile:
        """Return the pool that a descriptor names; raises `MessageError` for a mismatch."""
        file = self._file
        if file is None or file.name != ref.file or file.pool_id != ref.pool_id:
            file = self._open(ref)
        if not (0 <= ref.slot < file.slots and 0 <= ref.nbytes <= file.slot_bytes):
            raise MessageError(f"{ref.file}: no slot {ref.slot} of {ref.nbytes} bytes")
        return file

    @property
    def pinned(self) -> int:
        """Number of slots that views of this reader keep from being reused."""
        return sum(1 for count in self._file.views.values() if count) if self._file else 0

    def _open(self, ref: SlotRef) -> PoolFile:
        if self._file is None or self._file.name != ref.file:
            if not is_pool(ref.file, self._stem):
                raise MessageError("a descriptor names a file that is no pool of this port")
            self._file = PoolFile(self._folder, ref.file, writable=False)
        if self._file.pool_id != ref.pool_id:
            raise MessageError(f"{ref.file}: expected pool {ref.pool_id}, got another")
        return self._file
