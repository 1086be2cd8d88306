"""Locks of a frame pool: a slot is kept for its views and from other writers, and no longer."""

from collections.abc import Iterator

import pytest

from pipeline import MessageError, PoolExhausted
from pipeline.bus.pool import KEPT, PoolReader
from pipeline.run.memory_folder import MemoryFolder
from tests.pipeline.bus.test_pool import STEM, closing_memory, fill, writer


@pytest.fixture
def memory() -> Iterator[MemoryFolder]:
    with closing_memory() as folder:
        yield folder


def test_a_slot_that_is_read_twice_is_kept_until_the_last_view_dies(memory: MemoryFolder) -> None:
    pool, reader = writer(memory, 1), PoolReader(memory, STEM)
    ref = fill(pool, 1)
    first, second = reader.take(ref), reader.take(ref)
    assert first is not None
    assert second is not None

    del first
    with pytest.raises(PoolExhausted):
        pool.lease(8192)
    del second

    assert pool.lease(8192).slot == 0


def test_a_late_descriptor_does_not_give_away_the_slot_in_hand(memory: MemoryFolder) -> None:
    pool, reader = writer(memory, 1), PoolReader(memory, STEM)
    late = fill(pool, 1)
    view = reader.take(fill(pool, 2))

    assert reader.take(late) is None

    with pytest.raises(PoolExhausted):
        pool.lease(8192)
    assert view is not None
    assert view[0] == 2


def test_a_published_slot_is_kept_from_other_writers_while_its_own_lives(
    memory: MemoryFolder,
) -> None:
    first = writer(memory, 2, claim=KEPT)
    for ordinal in (1, 2):
        fill(first, ordinal, ordinal)
    successor = writer(memory, 2)

    with pytest.raises(PoolExhausted):
        successor.lease(8192)
    del first  # its process has ended

    assert fill(successor, 3, 3).slot in (0, 1)


def test_a_file_of_something_else_is_no_pool(memory: MemoryFolder) -> None:
    pool = writer(memory, 3)
    ref = fill(pool, 1)
    whole = memory.read(ref.file)
    damaged = {"magic": bytes(8) + whole[8:], "shorter": whole[:-4096], "tiny": whole[:100]}

    for data in damaged.values():
        memory.write(ref.file, data)
        with pytest.raises(MessageError, match="not a frame pool"):
            PoolReader(memory, STEM).take(ref)
