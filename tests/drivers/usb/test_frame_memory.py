"""Memory of the frame pool for an exposure and the next one."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import DTypeLike, NDArray

from drivers.usb.errors import LinkError
from drivers.usb.frame_header import Stream
from drivers.usb.frame_memory import FrameMemory, Kind
from pipeline.errors import PoolExhausted

KINDS: list[Kind] = [(Stream.CONTEXT, (2, 4), np.uint8), (Stream.ROI, (4, 8), np.uint8)]


class Pool:
    """Grants so many loans of each output."""

    def __init__(self, room: int) -> None:
        self.room = room
        self.lent: list[tuple[str, bool]] = []

    def __call__(
        self, output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        if sum(name == output for name, _ in self.lent) == self.room:
            raise PoolExhausted("full")
        self.lent.append((output, ahead))
        return np.empty(shape, dtype)


def test_the_next_exposure_gets_the_memory_that_was_lent_ahead() -> None:
    memory, pool = FrameMemory(ahead=True), Pool(2)
    memory.take(KINDS, pool)
    lent = memory.lend(KINDS, pool)
    assert lent is not None

    taken = memory.take(KINDS, pool)

    assert all(a is b for a, b in zip(taken, lent.values(), strict=True))
    assert pool.lent == [("context", True), ("roi", True)] * 2


def test_without_room_nothing_is_lent_ahead_and_the_exposure_is_still_read() -> None:
    memory, pool = FrameMemory(ahead=True), Pool(1)

    assert len(memory.take(KINDS, pool)) == 2
    assert memory.lend(KINDS, pool) == {}
    assert not memory.ready
    with pytest.raises(PoolExhausted):
        memory.take(KINDS, pool)


def test_memory_of_a_lost_exposure_is_used_again() -> None:
    memory, pool = FrameMemory(ahead=True), Pool(2)
    lost = memory.take(KINDS, pool)
    memory.lend(KINDS, pool)
    memory.return_lost([Stream.CONTEXT, Stream.ROI], lost)

    memory.take(KINDS, pool)
    again = memory.lend(KINDS, pool)

    assert again is not None
    assert [again[kind[0]] is one for kind, one in zip(KINDS, lost, strict=True)] == [True, True]


def test_a_frame_that_differs_from_the_one_before_is_an_error_of_the_link() -> None:
    memory, pool = FrameMemory(ahead=True), Pool(9)
    memory.take(KINDS, pool)
    memory.lend(KINDS, pool)

    with pytest.raises(LinkError, match=r"context: expected \(2, 4\), got \(2, 4\) of uint16"):
        memory.take([(Stream.CONTEXT, (2, 4), np.uint16)], pool)


def test_in_lockstep_nothing_is_lent_ahead() -> None:
    memory, pool = FrameMemory(ahead=False), Pool(9)
    taken = memory.take(KINDS, pool)
    memory.return_lost([Stream.CONTEXT, Stream.ROI], taken)

    assert memory.lend(KINDS, pool) is None
    assert memory.take(KINDS, pool)[0] is not taken[0]
    assert {ahead for _, ahead in pool.lent} == {False}
