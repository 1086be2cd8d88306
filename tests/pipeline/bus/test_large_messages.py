"""Messages with several large arrays, and messages that no reader could receive."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline import Message, MessageError
from pipeline.testing import header
from tests.pipeline.bus.edges import Edge


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """What may be large at some depth of a message."""

    depth_mm: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Views(Message):
    """A message with large arrays of its own, in a tuple and in a dataclass."""

    pixels: NDArray[np.uint8]
    others: tuple[NDArray[np.uint8], ...] = ()
    part: Part
    note: str = ""


class ViewsEdge(Edge):
    """An edge for `Views`, its reader on this host."""

    message: type[Message] = Views
    address = staticmethod(Path)


@pytest.fixture
def views() -> Iterator[ViewsEdge]:
    made = ViewsEdge()
    yield made
    made.arrivals.clear()
    made.memory.empty()


@pytest.mark.parametrize("loaned", [(), (0,), (1,), (2,), (0, 1), (1, 2), (0, 1, 2)])
def test_all_large_arrays_of_a_message_go_through_its_slot(
    views: ViewsEdge, loaned: tuple[int, ...]
) -> None:
    shapes = ((60, 60, 3), (500, 500), (300, 400))
    kinds = (np.uint8, np.uint8, np.float32)
    arrays = [
        views.out.loan(shape, kind) if number in loaned else np.empty(shape, kind)
        for number, (shape, kind) in enumerate(zip(shapes, kinds, strict=True))
    ]
    for number, array in enumerate(arrays):
        array[...] = number + 1
    pixels, other, depth_mm = arrays
    head = header(1)

    views.out.send(
        Views(header=head, pixels=pixels, others=(other,), part=Part(depth_mm=depth_mm)), head
    )

    assert len(views.wire.sent[0]) < 1000
    views.carry()
    received = views.arrivals[0].message
    assert isinstance(received, Views)
    for number, array in enumerate([received.pixels, *received.others, received.part.depth_mm]):
        assert array.shape == shapes[number]
        assert (array == number + 1).all()


def test_what_no_reader_could_receive_is_refused_and_not_counted(views: ViewsEdge) -> None:
    small = Part(depth_mm=np.zeros(1, np.float32))
    head = header(1)
    message = Views(header=head, pixels=np.zeros(1, np.uint8), part=small, note="a" * 200_000)

    with pytest.raises(MessageError, match="Views: expected at most 163840 bytes beside its large"):
        views.out.send(message, head)

    assert (views.account.sent, views.wire.sent) == (0, [])
    views.out.send(replace(message, note=""), head)
    assert views.account.sent == 1
