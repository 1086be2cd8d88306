"""A tap receives every message of an output, holds no slot, and counts what it missed."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import Frame, Percept, codec
from pipeline.bus.envelope import HANDSHAKE, MESSAGE, Envelope, first_of
from pipeline.bus.ledger import private_ledger
from pipeline.bus.outport import OutPort, Reader
from pipeline.bus.pool import PoolReader, PoolWriter, SlotRef
from pipeline.bus.pool_tap import PoolTap
from pipeline.bus.tap import Missed, Tap
from pipeline.codec import fingerprint
from pipeline.run.memory_folder import MemoryFolder
from pipeline.testing import header
from tests.pipeline.bus.edges import STEM, Wire


class Output:
    """An output without a reader in the graph, and the key that a tap listens on."""

    def __init__(self) -> None:
        self.memory = MemoryFolder.claim()
        self.key = Wire(matched=True)
        self.readers: list[Reader] = []
        self.out = self.instance(1)

    def instance(self, epoch: int) -> OutPort:
        return OutPort(
            Frame, Wire(), self.key, Wire(), self.readers,  # type: ignore[arg-type]
            lambda claim: PoolWriter(self.memory, STEM, 2, claim), epoch,
        )  # fmt: skip

    def send(self, seq: int, side_px: int = 60) -> None:
        pixels = self.out.loan((side_px, side_px, 3), np.uint8)
        pixels[...] = seq % 251
        head = header(seq)
        self.out.send(Frame(header=head, pixels=pixels), head)

    def carry(self, tap: Tap, keep: Callable[[int], bool] = lambda _index: True) -> None:
        for index, payload in enumerate(self.key.sent):
            if keep(index):
                tap.receive(payload)
        self.key.sent.clear()


@pytest.fixture
def output() -> Iterator[Output]:
    made = Output()
    yield made
    made.memory.empty()


def heard(tap: Tap) -> list[int]:
    seqs = []
    while (one := tap.next(0.0)) is not None:
        seqs.append(one.header.seq)
    return seqs


def test_a_tap_receives_pictures_whose_slot_was_reused_long_ago(output: Output) -> None:
    tap = Tap(Frame)
    for seq in range(20):
        output.send(seq)

    output.carry(tap)  # after the last one: the output has two slots

    one = tap.next(0.0)
    assert one is not None
    assert isinstance(one.message, Frame)
    assert (one.message.pixels.shape, one.message.window) == ((60, 60, 3), (0, 0, 0, 0))
    assert heard(tap) == list(range(1, 20))
    assert tap.missed == Missed()


def test_what_a_tap_keeps_holds_no_slot(output: Output) -> None:
    tap, kept = Tap(Frame), []
    for seq in range(20):
        output.send(seq)  # raises PoolExhausted where both slots are held
        output.carry(tap)
        kept.append(tap.next(0.0))

    assert len(kept) == 20


def test_small_pictures_and_none_arrive_unchanged(output: Output) -> None:
    tap = Tap(Frame)
    output.send(251 + 7, side_px=2)
    output.out.send(None, header(9))
    output.carry(tap)

    first, second = tap.next(0.0), tap.next(0.0)

    assert first is not None
    assert second is not None
    assert isinstance(first.message, Frame)
    assert first.message.pixels.tolist() == [[[7] * 3] * 2] * 2
    assert (second.header.seq, second.message) == (9, None)


def test_what_the_bus_drops_is_counted_and_marked(output: Output) -> None:
    tap = Tap(Frame)
    for seq in range(10):
        output.send(seq)

    output.carry(tap, lambda index: index not in (3, 4, 7))

    assert tap.missed == Missed(on_the_way=3)
    assert str(tap.missed) == "missed 3: 3 lost on the way"
    after = {one.header.seq: one.after_loss for one in iter(lambda: tap.next(0.0), None)}
    assert after == {0: False, 1: False, 2: False, 5: True, 6: False, 8: True, 9: False}


def test_what_a_slow_reader_of_the_tap_leaves_is_dropped_and_counted(output: Output) -> None:
    tap = Tap(Frame, room=4)
    for seq in range(10):
        output.send(seq)

    output.carry(tap)

    assert heard(tap) == [0, 1, 2, 3]
    assert tap.missed == Missed(slow=6)


def test_messages_of_another_schema_are_counted(output: Output) -> None:
    tap = Tap(Percept)
    output.send(1)
    output.carry(tap)

    assert heard(tap) == []
    assert tap.missed == Missed(refused=1)


@pytest.mark.parametrize("read", [False, True])
def test_a_restart_is_heard_at_once_and_nothing_before_it_counts_as_missed(
    output: Output, *, read: bool
) -> None:
    if read:
        output.readers.append(Reader(private_ledger(1, 0).edges[0], False, 4))
        output.out = output.instance(1)
    tap = Tap(Frame)
    for seq in range(5):
        output.send(seq, side_px=2)
    output.out = output.instance(2)  # killed between two messages
    output.out.has_lost()
    output.out.handshake()
    for seq in range(5, 8):
        output.send(seq, side_px=2)

    output.carry(tap)

    assert heard(tap) == list(range(8))
    assert tap.missed == Missed()
    assert tap.instances == 2


@pytest.mark.parametrize("read", [False, True])
def test_what_is_sent_before_a_tap_hears_a_new_instance_is_counted(
    output: Output, *, read: bool
) -> None:
    if read:
        output.readers.append(Reader(private_ledger(1, 0).edges[0], False, 4))
        output.out = output.instance(1)
    tap = Tap(Frame)
    for seq in range(2):
        output.send(seq, side_px=2)
    output.out = output.instance(2)
    for seq in range(2, 6):
        output.send(seq, side_px=2)

    output.carry(tap, lambda index: index not in (2, 3))  # its link is not up yet

    assert heard(tap) == [0, 1, 4, 5]
    assert tap.missed == Missed(on_the_way=2)


def test_a_swap_that_is_rolled_back_counts_no_message_as_missed(output: Output) -> None:
    tap, first = Tap(Frame), output.out
    output.send(0, side_px=2)
    output.out = output.instance(2)
    output.out.begin(2)
    output.send(1, side_px=2)
    output.out = first
    output.out.begin(3)
    output.send(2, side_px=2)

    output.carry(tap)

    assert heard(tap) == [0, 1, 2]
    assert tap.missed == Missed()


def test_a_straggler_of_the_old_instance_is_no_loss_and_a_superseded_one_is_not_heard() -> None:
    tap, schema = Tap(Frame), fingerprint(Frame)

    def send(ordinal: int, epoch: int, kind: int = 2) -> None:
        tap.receive(Envelope.render(kind, ordinal, epoch, schema, None, header(ordinal)))

    send(5, 1)
    send(7, 2)  # over another link, so it arrives before the last one of the old instance
    send(6, 1)
    send(7, 1)

    assert heard(tap) == [5, 7, 6]
    assert tap.missed == Missed()


def test_a_handshake_makes_a_tap_count_what_it_missed(output: Output) -> None:
    tap = Tap(Frame)
    output.send(0)
    for seq in range(1, 4):
        output.send(seq)
    output.out.has_lost()
    output.out.handshake()

    output.carry(tap, lambda index: index not in (1, 2, 3))

    assert tap.missed == Missed(on_the_way=3)


@given(noise=st.binary(max_size=80))
def test_noise_on_the_key_never_raises_and_never_counts(noise: bytes) -> None:
    tap = Tap(Frame)

    tap.receive(noise)

    assert (heard(tap), tap.missed) == ([], Missed())


@pytest.mark.parametrize("nbytes", [1 << 45, 1 << 62])
def test_a_descriptor_of_an_array_that_no_memory_holds_is_counted(nbytes: int) -> None:
    tap, schema = Tap(Frame), codec.schema(Frame)
    frame = Frame(header=header(1), pixels=np.zeros((8, 8), np.uint8))
    body = schema.write(frame, lambda _: 0)
    body[schema.names.index("pixels")] = ("|u1", (nbytes // 8, 8), 0)
    slot = SlotRef("a.out.00000000", 1, 0, 1, nbytes)

    tap.receive(Envelope.render(MESSAGE, 1, 1, schema.fingerprint, slot, body))

    assert heard(tap) == []
    assert sum(tap.missed) == 1


@pytest.mark.parametrize("offset", [0, 8])
def test_an_array_beyond_its_slot_is_counted_and_not_heard(offset: int) -> None:
    tap, schema = Tap(Frame), codec.schema(Frame)
    frame = Frame(header=header(1), pixels=np.zeros((8, 8), np.uint8))
    body = schema.write(frame, lambda _: offset)
    slot = SlotRef("a.out.00000000", 1, 0, 1, 64)

    tap.receive(Envelope.render(MESSAGE, 1, 1, schema.fingerprint, slot, body))

    assert (len(heard(tap)), tap.missed.refused) == ((1, 0) if offset == 0 else (0, 1))


def test_what_a_relay_skipped_is_counted_as_slow_and_never_twice(output: Output) -> None:
    tap = Tap(Frame)
    for seq in range(5):
        output.send(seq)
    output.carry(tap, lambda index: index not in (1, 2, 3))

    tap.skipped = 2
    assert tap.missed == Missed(on_the_way=1, slow=2)

    tap.skipped = 9  # the relay counts what was skipped before this tap began, too
    assert tap.missed == Missed(slow=3)


EVENTS = st.lists(st.tuples(st.integers(0, 2), st.integers(0, 40), st.integers(1, 3)), max_size=12)


@given(events=EVENTS, private=st.booleans())
def test_no_order_of_messages_makes_a_tap_raise_or_count_below_zero(
    events: list[tuple[int, int, int]], *, private: bool
) -> None:
    tap, schema = Tap(Frame), fingerprint(Frame)

    for kind, number, epoch in events:
        ordinal = number + (first_of(epoch) - 1 if private else 0)
        body: Any = None if kind == HANDSHAKE else header(number)
        tap.receive(Envelope.render(kind, ordinal, epoch, schema, None, body))

    heard(tap)
    assert min(tap.missed) >= 0


def test_a_pool_is_read_by_a_tap_without_keeping_a_slot_from_its_writer() -> None:
    memory = MemoryFolder.claim()
    writer, tap = PoolWriter(memory, STEM, 1, lambda _ordinal: 1), PoolTap(memory, STEM)
    lease = writer.lease(10_000)
    array = lease.array((10_000,), np.uint8)
    assert array is not None
    array[...] = 7
    ref = lease.ref()
    assert tap.take(ref) is None  # it is being written
    writer.publish(lease, 1)

    copy = tap.take(ref)

    assert copy is not None
    assert (copy == 7).all()
    assert not copy.flags.writeable
    again = writer.lease(10_000)  # the only slot there is
    assert tap.take(ref) is None
    written = again.array((10_000,), np.uint8)
    assert written is not None
    written[...] = 9
    assert (copy == 7).all()
    writer.abandon(again)
    assert PoolReader(memory, STEM).take(again.ref()) is not None
    memory.empty()
