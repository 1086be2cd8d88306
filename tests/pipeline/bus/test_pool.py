"""Frame pools copy nothing, overwrite no picture in use, and free the slots of dead readers."""

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline import MessageError, PoolExhausted, RunError
from pipeline.bus.pool import (
    DONE,
    KEPT,
    SPARE,
    Lease,
    PoolReader,
    PoolWriter,
    SlotRef,
)
from pipeline.run.memory_folder import MemoryFolder

STEM = "eye.out"


@contextlib.contextmanager
def closing_memory() -> Iterator[MemoryFolder]:
    folder = MemoryFolder.claim()
    yield folder
    folder.empty()
    assert not folder.exists


@pytest.fixture
def memory() -> Iterator[MemoryFolder]:
    with closing_memory() as folder:
        yield folder


def writer(memory: MemoryFolder, slots: int = 3, *, claim: int = DONE) -> PoolWriter:
    return PoolWriter(memory, STEM, slots, lambda _ordinal: claim)


def fill(pool: PoolWriter, value: int, ordinal: int = 1, nbytes: int = 8192) -> SlotRef:
    lease = pool.lease(nbytes)
    array = lease.array((nbytes,), np.uint8)
    assert array is not None
    array[:] = value
    pool.publish(lease, ordinal)
    return lease.ref()


def test_the_readers_array_lies_in_the_writers_memory(memory: MemoryFolder) -> None:
    pool = writer(memory)
    lease = pool.lease(8192)
    written = lease.array((8192,), np.uint8)
    assert written is not None
    written[:] = 1
    pool.publish(lease, 1)
    view = PoolReader(memory, STEM).take(lease.ref())
    assert view is not None

    written[17] = 99  # the view shows it only if both share the memory

    assert view[17] == 99


def test_a_views_slot_is_not_reused_until_its_last_view_dies(memory: MemoryFolder) -> None:
    pool, reader = writer(memory, 2), PoolReader(memory, STEM)
    view = reader.take(fill(pool, 1))
    assert view is not None
    part = view[10:20].reshape(2, 5)
    del view
    other = pool.lease(8192)

    with pytest.raises(PoolExhausted, match="2 slots"):
        pool.lease(8192)
    assert part.tolist() == [[1] * 5] * 2
    del part

    assert pool.lease(8192).slot != other.slot


def test_views_are_read_only(memory: MemoryFolder) -> None:
    view = PoolReader(memory, STEM).take(fill(writer(memory), 1))
    assert view is not None

    with pytest.raises(ValueError, match="read-only"):
        view[0] = 2


def test_a_reused_slot_is_noticed_by_its_generation(memory: MemoryFolder) -> None:
    pool, reader = writer(memory, 1), PoolReader(memory, STEM)
    old = fill(pool, 1)
    new = fill(pool, 2)

    assert reader.take(old) is None
    taken = reader.take(new)
    assert taken is not None
    assert taken[0] == 2


def test_a_published_slot_waits_for_readers_on_their_way(memory: MemoryFolder) -> None:
    pool = writer(memory, 2, claim=KEPT)
    fill(pool, 1, 1)
    fill(pool, 2, 2)

    with pytest.raises(PoolExhausted):
        pool.lease(8192)


def test_the_slot_written_last_is_taken_again_as_soon_as_it_is_done(memory: MemoryFolder) -> None:
    pool = writer(memory, claim=DONE)

    assert len({fill(pool, value, value).slot for value in range(6)}) == 1


def test_of_several_spare_slots_the_oldest_is_reused_first(memory: MemoryFolder) -> None:
    pool = writer(memory, claim=SPARE)

    slots = [fill(pool, value, value).slot for value in range(6)]

    assert set(slots[:3]) == {0, 1, 2}
    assert slots[3:] == slots[:3]


def test_a_slot_leased_ahead_is_the_next_one_and_holds_nothing_up(memory: MemoryFolder) -> None:
    pool = writer(memory, 2, claim=KEPT)
    fill(pool, 1, 1)
    pool.prepare()
    pool.prepare()

    assert fill(pool, 2, 2).slot == 1

    pool.prepare()  # none is free: that is no error yet
    with pytest.raises(PoolExhausted):
        pool.lease(8192)


def test_a_slot_leased_ahead_that_is_too_small_is_left_for_a_bigger_file(
    memory: MemoryFolder,
) -> None:
    pool, reader = writer(memory), PoolReader(memory, STEM)
    fill(pool, 1)
    pool.prepare()

    view = reader.take(fill(pool, 7, nbytes=1 << 20))

    assert view is not None
    assert view.min() == 7


def test_a_restarted_writer_goes_on_in_the_same_file(memory: MemoryFolder) -> None:
    first = fill(writer(memory), 1)
    second = fill(writer(memory), 2)

    assert second.file == first.file
    assert second.generation > first.generation or second.slot != first.slot


def test_bigger_messages_get_a_new_file_and_old_views_stay_whole(memory: MemoryFolder) -> None:
    pool, reader = writer(memory), PoolReader(memory, STEM)
    small = reader.take(fill(pool, 7))
    big = reader.take(fill(pool, 8, nbytes=100_000))

    assert small is not None
    assert big is not None
    assert small.sum() == 7 * 8192
    assert big.sum() == 8 * 100_000


def test_a_reader_on_its_way_still_finds_the_file_that_was_outgrown(memory: MemoryFolder) -> None:
    pool, reader = writer(memory), PoolReader(memory, STEM)
    small, big = fill(pool, 7, 1), fill(pool, 8, 2, nbytes=100_000)

    taken = [reader.take(small), reader.take(big)]

    assert [view is not None and int(view[0]) for view in taken] == [7, 8]


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.tuples(st.integers(8192, 200_000), st.integers(0, 3)), min_size=2, max_size=40),
    st.integers(0, 39),
)
def test_no_message_is_lost_however_messages_grow_and_readers_are_late(
    messages: list[tuple[int, int]], resized_at: int
) -> None:
    with closing_memory() as memory:
        unread: list[tuple[int, SlotRef]] = []
        reader = PoolReader(memory, STEM)

        def claim(ordinal: int) -> int:
            return KEPT if any(ordinal == number for number, _ in unread) else DONE

        pool = PoolWriter(memory, STEM, 4, claim)
        for ordinal, (nbytes, late) in enumerate(messages):
            if ordinal == resized_at:
                pool.resize(6)
            unread.append((ordinal, fill(pool, ordinal, ordinal, nbytes)))
            last = ordinal == len(messages) - 1
            while len(unread) > (0 if last else late):
                number, ref = unread.pop(0)
                view = reader.take(ref)
                assert view is not None, number
                assert view.min() == view.max() == number
                del view  # it leases its slot


def test_outgrown_files_are_removed_when_all_readers_had_their_chance(
    memory: MemoryFolder,
) -> None:
    fill(writer(memory), 1)
    pool = writer(memory)  # restarted: its predecessor's file is outgrown, too

    for ordinal in range(1, 4):
        fill(pool, ordinal, ordinal, nbytes=ordinal * 10_000)
    assert len(memory.names()) == 4

    for ordinal, left in ((4, 3), (5, 2), (6, 1)):  # of three slots each
        fill(pool, ordinal, ordinal)
        assert len(memory.names()) == left


def test_a_successor_goes_on_in_the_largest_file_whatever_is_outgrown(
    memory: MemoryFolder,
) -> None:
    for _ in range(8):  # names are random
        first = writer(memory, claim=KEPT)
        fill(first, 1, 1)
        large = fill(first, 2, 2, nbytes=100_000)

        second = writer(memory)
        assert fill(second, 3, 3).file == large.file
        larger = fill(second, 4, 4, nbytes=200_000)
        first.refresh()  # the successor has failed
        again = fill(first, 5, 5)

        assert again.file == larger.file
        assert PoolReader(memory, STEM).take(again) is not None
        memory.empty()
        memory = MemoryFolder.claim()
    memory.empty()


def test_a_writer_that_has_outgrown_a_larger_file_itself_goes_on_in_its_own(
    memory: MemoryFolder,
) -> None:
    pool = writer(memory)
    fill(pool, 1, 1, nbytes=100_000)
    pool.resize(5)
    own = fill(pool, 2, 2)

    pool.refresh()

    assert fill(pool, 3, 3).file == own.file


def test_memory_lent_before_its_file_was_outgrown_is_found_by_readers(
    memory: MemoryFolder,
) -> None:
    pool = writer(memory)
    fill(pool, 1, 1)
    lent = pool.lease(8192)
    for ordinal in (2, 3, 4):
        fill(pool, ordinal, ordinal, nbytes=100_000)

    pool.publish(lent, 5)

    assert PoolReader(memory, STEM).take(lent.ref()) is not None


def test_without_room_outgrown_files_go_first(
    memory: MemoryFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    pool = writer(memory)
    fill(pool, 1, 1)
    reserve = os.posix_fallocate

    def scarce(handle: int, start: int, size: int) -> None:
        if len(memory.names()) > 1:
            raise OSError(28, "No space left on device")
        reserve(handle, start, size)

    monkeypatch.setattr(os, "posix_fallocate", scarce)

    large = fill(pool, 2, 2, nbytes=100_000)

    assert memory.names() == [large.file]


def test_a_full_memory_is_an_error_and_leaves_nothing(memory: MemoryFolder, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="no room"):
        writer(memory, 400).lease(1 << 40)

    assert memory.names() == []


@pytest.mark.parametrize(
    "ref",
    [
        SlotRef("../../etc/passwd", 1, 0, 1, 10),
        SlotRef("{stem}.zzzzzzzz", 1, 0, 1, 10),
        SlotRef("{file}", 1, 0, 1, 10),
        SlotRef("{file}", -1, 99, 1, 10),
        SlotRef("{file}", -1, 3, 1, 10),  # one beyond the last
        SlotRef("{file}", -1, 0, 1, 1 << 40),
        SlotRef("{file}", -1, -1, 1, 10),
    ],
)
def test_a_forged_descriptor_is_refused(memory: MemoryFolder, ref: SlotRef) -> None:
    real = fill(writer(memory), 1)
    name = ref.file.format(stem=STEM, file=real.file)
    pool_id = real.pool_id if ref.pool_id == -1 else ref.pool_id
    forged = SlotRef(name, pool_id, ref.slot, ref.generation, ref.nbytes)

    with pytest.raises(MessageError):
        PoolReader(memory, STEM).take(forged)


def test_two_arrays_of_one_message_share_a_slot(memory: MemoryFolder) -> None:
    lease: Lease = writer(memory).lease(30_000)
    first, second = lease.array((100, 100), np.uint8), lease.array((50, 50), np.float32)

    assert first is not None
    assert second is not None
    assert lease.offset_of(first) == 0
    assert lease.offset_of(second) == 10_048
    assert lease.offset_of(np.zeros(3)) is None


def test_memory_of_an_earlier_lease_is_no_part_of_the_next_one_of_its_slot(
    memory: MemoryFolder,
) -> None:
    pool = writer(memory)
    earlier = pool.lease(8192)
    kept = earlier.array((8192,), np.uint8)
    assert kept is not None
    pool.publish(earlier, 1)

    lease = pool.lease(8192)

    assert lease.slot == earlier.slot
    assert lease.offset_of(kept) is None


HOLDER = """
import sys, time
from pathlib import Path
from pipeline.bus.pool import PoolReader, SlotRef
from pipeline.private_folder import PrivateFolder
pool = PoolReader(PrivateFolder(Path(sys.argv[1])), "eye.out")
view = pool.take(SlotRef(sys.argv[2], *map(int, sys.argv[3:])))
print(view is not None, flush=True)
time.sleep(60)
"""


def test_a_killed_reader_gives_its_slot_back_at_once(memory: MemoryFolder) -> None:
    pool = writer(memory, 1)
    ref = fill(pool, 1)
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(memory.path), ref.file]
        + [str(n) for n in (ref.pool_id, ref.slot, ref.generation, ref.nbytes)],
        stdout=subprocess.PIPE,
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == b"True\n"
    with pytest.raises(PoolExhausted):
        pool.lease(8192)

    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    holder.stdout.close()

    assert pool.lease(8192).slot == 0


def test_ten_thousand_frames_leave_no_lock_and_no_memory_behind(memory: MemoryFolder) -> None:
    pool, reader = writer(memory, 3), PoolReader(memory, STEM)

    for i in range(10_000):
        view = reader.take(fill(pool, i % 251, i))
        assert view is not None
        assert view[0] == i % 251
        del view

    assert reader.pinned == 0
    assert multiprocessing.active_children() == []
