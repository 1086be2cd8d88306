"""The two ends of an edge: every message is accounted for exactly once."""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import Frame, Header, MessageError, Percept, PoolExhausted
from pipeline.bus.envelope import Envelope
from pipeline.bus.inport import InPort
from pipeline.bus.ledger import private_ledger
from pipeline.bus.outport import PROBE_S, OutPort, Reader
from pipeline.bus.pool import DONE, KEPT, SPARE, PoolReader
from pipeline.codec import to_bytes
from pipeline.testing import header, picture
from tests.pipeline.bus.edges import STEM, Edge, Wire


@pytest.fixture
def edge() -> Iterator[Edge]:
    made = Edge()
    yield made
    made.arrivals.clear()
    made.memory.empty()


def test_a_loaned_picture_is_not_copied_on_its_way(edge: Edge) -> None:
    pixels = edge.out.loan((60, 60, 3), np.uint8)
    pixels[...] = 5
    head = header(1)
    edge.out.send(Frame(header=head, pixels=pixels), head)
    edge.carry()
    received = edge.arrivals[0].message
    assert isinstance(received, Frame)

    pixels[0, 0, 0] = 77  # forbidden to an author; the reader sees it only in shared memory

    assert received.pixels[0, 0, 0] == 77
    assert not received.pixels.flags.writeable


def test_a_loaned_picture_that_was_kept_is_sent_again(edge: Edge) -> None:
    pixels = edge.out.loan((60, 60, 3), np.uint8)
    pixels[...] = 5

    for seq in range(3):
        edge.out.send(Frame(header=header(seq), pixels=pixels), header(seq))
        edge.carry()
        received = edge.arrivals.pop().message
        assert isinstance(received, Frame)
        assert (received.pixels == 5).all()
        del received  # the slot is free, and taken for the next message

    assert not edge.account.dropped("refused")


def test_a_descriptor_is_small_whatever_the_picture(edge: Edge) -> None:
    edge.send(1, side_px=400)

    assert len(edge.wire.sent[0]) < 1000


def test_a_lossless_reader_has_credit_for_its_depth_only(edge: Edge) -> None:
    edge.out.handshake()
    edge.carry()
    for seq in range(3):
        assert edge.out.has_credit()
        edge.send(seq)
    edge.carry()
    with pytest.raises(PoolExhausted):
        edge.send(3)
    edge.finish()

    edge.send(3)
    edge.carry()
    assert edge.account.sent == 4


def test_a_picture_whose_slot_was_reused_is_counted_as_overwritten() -> None:
    edge = Edge(lossless=False)
    edge.out.handshake()
    edge.carry()
    for seq in range(5):
        edge.send(seq)

    edge.carry()

    assert [arrival.header.seq for arrival in edge.arrivals] == [3, 4]  # the newest two are kept
    assert edge.account.dropped("overwritten") == 3
    edge.finish()
    assert edge.account.accounted == edge.account.sent == 5
    edge.memory.empty()


@pytest.mark.parametrize(
    ("lossless", "newest", "claim"),
    [(True, 30, KEPT), (False, 13, KEPT), (False, 14, SPARE), (False, 15, SPARE)],
)
def test_a_reader_of_the_latest_has_its_chance_until_two_newer_messages_are_there(
    lossless: bool, newest: int, claim: int
) -> None:
    edge = Edge()
    reader = Reader(edge.account, lossless, depth=4)
    assert reader.claim(12, newest) == SPARE  # it has not connected

    edge.account.attached_epoch, edge.account.base = 1, 10  # a reader that was added later
    edge.account.seen = 1
    assert reader.claim(11, newest) == DONE
    assert reader.claim(12, newest) == claim
    edge.account.reader_epoch = 0
    assert reader.claim(12, newest) == DONE
    edge.memory.empty()


def test_an_overrun_is_counted_on_every_edge_and_only_its_cause_is_broken(edge: Edge) -> None:
    other = Edge(lossless=False)
    edge.out.readers += other.out.readers
    edge.out.handshake()
    edge.carry()
    edge.account.sent = edge.depth

    edge.out.overrun()

    assert (edge.account.overrun, other.account.overrun) == (1, 1)
    assert (edge.account.broken, other.account.broken) == (1, 0)
    other.memory.empty()


def test_a_reader_that_never_connected_does_not_block_the_writer() -> None:
    edge = Edge(depth=2)
    for seq in range(10):
        assert edge.out.has_credit()
        edge.send(seq)
    edge.memory.empty()


def test_a_lost_descriptor_is_counted_as_a_gap(edge: Edge) -> None:
    edge.send(0)
    edge.carry()
    edge.send(1)
    edge.wire.sent.clear()
    edge.send(2)
    edge.carry()

    assert edge.account.dropped("gap") == 1
    edge.finish()
    assert edge.account.accounted == edge.account.sent == 3


def test_a_reader_that_lost_every_message_counts_them_and_the_writer_continues(
    edge: Edge, monkeypatch: pytest.MonkeyPatch
) -> None:
    edge.out.handshake()
    edge.carry()
    while edge.out.has_credit():
        edge.send(1, side_px=20)
    edge.wire.sent.clear()  # the cable was pulled
    edge.out.handshake()
    assert edge.wire.sent == []

    now_s = time.monotonic()
    monkeypatch.setattr("pipeline.bus.outport.time.monotonic", lambda: now_s + 2 * PROBE_S)
    edge.out.handshake()
    edge.carry()

    assert edge.account.gap == edge.account.sent == edge.depth
    assert edge.out.has_credit()


def test_a_new_reader_counts_what_its_predecessor_left(edge: Edge) -> None:
    edge.send(0)
    edge.carry()
    edge.arrivals.clear()  # received and never finished: the reader was killed
    edge.send(1)
    edge.wire.sent.clear()  # lost: no reader was there
    edge.account.reader_epoch = 2
    edge.port = edge.reader(2)

    edge.out.handshake()
    edge.carry()

    assert edge.account.lost_in_crash == 2
    assert edge.account.live
    assert edge.account.accounted == edge.account.sent == 2


def test_a_superseded_writer_is_fenced(edge: Edge) -> None:
    edge.send(0)
    edge.account.writer_epoch = 2  # its successor has been started

    edge.carry()
    edge.send(1)

    assert edge.account.dropped("fenced") == 1
    assert edge.account.sent == 1  # it sends nothing any more
    assert edge.arrivals == []


def test_a_message_of_another_schema_is_refused_and_counted(edge: Edge) -> None:
    percept = Percept(
        header=header(0), boxes=np.zeros((0, 4), np.float32), ids=np.zeros(0, np.int32),
        scores=np.zeros(0, np.float32),
    )  # fmt: skip
    other = OutPort(Percept, edge.wire, Wire(), Wire(), edge.out.readers, lambda _claim: None, 1)  # type: ignore[arg-type,return-value]
    other.send(percept, percept.header)

    edge.carry()

    assert edge.account.dropped("refused") == 1
    assert edge.account.accounted == edge.account.sent == 1


@given(noise=st.binary(max_size=80))
def test_noise_on_the_key_never_raises_and_never_counts_as_sent(noise: bytes) -> None:
    edge = Edge()

    edge.port.receive(noise)

    assert edge.account.unexpected == 1
    assert edge.account.accounted == 0


def test_a_repeated_descriptor_is_counted_as_unexpected(edge: Edge) -> None:
    edge.send(0)
    payload = edge.wire.sent[0]
    edge.carry()
    edge.port.receive(payload)

    assert len(edge.arrivals) == 1
    assert edge.account.unexpected == 1


def test_bytes_are_rendered_only_while_a_remote_reader_matches() -> None:
    near, far = Edge(), Edge(remote=True)
    near.send(3)
    far.send(3)

    assert near.remote.sent == []
    far.port.receive(far.remote.sent[0])  # a remote reader needs no pool
    received = far.arrivals[0].message
    assert isinstance(received, Frame)
    assert (received.pixels == 3).all()
    near.memory.empty()
    far.memory.empty()


def test_a_tap_is_sent_descriptors_only_while_there_is_one(edge: Edge) -> None:
    edge.send(1)
    assert edge.taps.sent == []

    edge.taps.matched = True
    edge.wire.sent.clear()
    edge.send(2)

    assert edge.taps.sent == edge.wire.sent != []


def test_a_reader_that_joins_counts_from_the_message_after(edge: Edge) -> None:
    for seq in range(3):
        edge.send(seq)
    joined, arrivals = private_ledger(1, 0).edges[0], []
    joined.reader_epoch = 1

    edge.out.change_readers([*edge.out.readers, Reader(joined, True, depth=4)], slots=6)
    pool = PoolReader(edge.memory, STEM)
    port = InPort(Frame, joined, pool, 1, arrivals.append)
    edge.wire.sent.clear()
    edge.out.handshake()
    edge.send(3)
    for payload in edge.wire.sent:
        port.receive(payload)

    assert [arrival.header.seq for arrival in arrivals] == [3]
    assert (joined.base, joined.sent, joined.seen, joined.accounted) == (3, 1, 1, 0)
    arrivals.clear()


def test_a_tap_copies_what_it_would_pin() -> None:
    edge = Edge(lossless=False)
    edge.port = edge.reader(1, tap=True)
    for seq in range(12):
        edge.send(seq)
        edge.carry()

    values = [a.message.pixels[0, 0, 0] for a in edge.arrivals if isinstance(a.message, Frame)]
    assert values == list(range(12))  # all are kept, although the pool has three slots
    assert not [a for a in edge.arrivals if a.message.pixels.flags.writeable]  # type: ignore[union-attr]
    edge.arrivals.clear()
    edge.memory.empty()


def test_none_is_sent_as_a_message(edge: Edge) -> None:
    edge.out.send(None, header(4))
    edge.carry()

    assert edge.arrivals[0].message is None
    assert edge.arrivals[0].header == header(4)


def test_the_wrong_message_is_refused_where_it_is_sent(edge: Edge) -> None:
    percept = Percept(
        header=header(0), boxes=np.zeros((0, 4), np.float32), ids=np.zeros(0, np.int32),
        scores=np.zeros(0, np.float32),
    )  # fmt: skip

    with pytest.raises(MessageError, match="expected Frame to send, got Percept"):
        edge.out.send(percept, percept.header)


@pytest.mark.parametrize("change", [{"seq": 9}, {"stamp_ns": 1}, {"stream": "x"}])
def test_the_header_arrives_untouched(edge: Edge, change: dict[str, object]) -> None:
    head: Header = replace(header(2), **change)  # type: ignore[arg-type]
    edge.out.send(Frame(header=head, pixels=picture(2, 2, seed=1)), head)
    edge.carry()

    assert edge.arrivals[0].header == head


def test_an_envelope_of_another_version_is_refused() -> None:
    with pytest.raises(MessageError, match="version"):
        Envelope.parse(to_bytes([99, 1, 1, 1, b"", None, []]))


def told_of_losses(edge: Edge) -> list[int]:
    """Send a handshake; return one entry for every loss that the reader was notified of."""
    told: list[int] = []
    edge.port.on_loss = lambda: told.append(1)
    edge.out.handshake()
    edge.carry()
    return told


def test_a_reader_is_notified_of_a_loss_once(edge: Edge) -> None:
    edge.out.handshake()
    edge.carry()

    edge.out.has_lost()

    assert told_of_losses(edge) == [1]
    assert told_of_losses(edge) == []


def test_a_restarted_writer_reports_a_loss_and_one_that_took_over_does_not(edge: Edge) -> None:
    edge.out.handshake()
    edge.carry()

    edge.wire.fresh = True
    edge.out = edge.writer(2)
    assert told_of_losses(edge) == [1]

    edge.out.begin(3)
    assert told_of_losses(edge) == []


def test_memory_lent_ahead_is_sent_with_a_later_message(edge: Edge) -> None:
    lent = [edge.out.loan((60, 60, 3), np.uint8, ahead=True) for _ in range(2)]
    for seq, pixels in enumerate(lent):
        pixels[...] = seq + 1

    for seq, pixels in enumerate(lent):
        edge.out.send(Frame(header=header(seq), pixels=pixels), header(seq))
        edge.out.discard()  # as at the end of a call, after which only loans ahead are kept
        pixels[0, 0, 0] = 77  # forbidden to an author; the reader sees it only in shared memory
    edge.carry()

    messages = [arrival.message for arrival in edge.arrivals]
    assert [int(m.pixels[1, 0, 0]) for m in messages if isinstance(m, Frame)] == [1, 2]
    assert [int(m.pixels[0, 0, 0]) for m in messages if isinstance(m, Frame)] == [77, 77]


def test_a_third_loan_ahead_is_refused_until_one_was_sent_or_given_back(edge: Edge) -> None:
    first, second = (edge.out.loan((60, 60, 3), np.uint8, ahead=True) for _ in range(2))

    with pytest.raises(PoolExhausted, match="2 slots are lent ahead"):
        edge.out.loan((60, 60, 3), np.uint8, ahead=True)
    edge.out.give_back(Frame(header=header(0), pixels=first))
    third = edge.out.loan((60, 60, 3), np.uint8, ahead=True)

    assert third.ctypes.data != second.ctypes.data
    edge.out.loan((60, 60, 3), np.uint8)  # a slot is left for one that is not ahead
