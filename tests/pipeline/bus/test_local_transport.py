"""The local transport delivers whole packets in order, and no reader can block a writer."""

import time
from pathlib import Path

import pytest

from pipeline.bus.local_transport import LocalReceiver, LocalSender


@pytest.fixture
def address(short_path: Path) -> Path:
    return short_path / "node.recv"


def drained(receiver: LocalReceiver, got: list[bytes], count: int) -> list[bytes]:
    deadline = time.monotonic() + 60
    while len(got) < count and time.monotonic() < deadline:
        receiver.wait(0.05)
    return got


def test_packets_arrive_whole_and_in_order(address: Path) -> None:
    receiver, got = LocalReceiver(address), []
    receiver.expect(7, got.append)
    sender = LocalSender([(7, address)])
    assert sender.connect()
    packets = [bytes([i]) * (1 + 997 * i) for i in range(40)]

    for number, packet in enumerate(packets):
        sender.send(packet)
        drained(receiver, got, number - 2)  # a few packets are always in flight

    assert drained(receiver, got, 40) == packets
    sender.close()
    receiver.close()


def test_a_writer_never_waits_for_a_reader_that_stands_still(address: Path) -> None:
    receiver, got = LocalReceiver(address), []
    receiver.expect(1, got.append)
    sender = LocalSender([(1, address)])
    sender.connect()

    full = [sender.send(b"x" * 1000) for _ in range(5000)]

    assert full[0] == []
    assert full[-1] == [(1, address)]
    arrived = sum(lost == [] for lost in full)
    assert 50 < arrived < 5000
    assert len(drained(receiver, got, arrived)) == arrived
    sender.close()
    receiver.close()


def test_a_reader_that_comes_back_is_found_again(address: Path) -> None:
    receiver = LocalReceiver(address)
    receiver.expect(1, lambda _packet: None)
    sender = LocalSender([(1, address)])
    assert sender.connect()
    assert not sender.connect()
    receiver.close()
    sender.send(b"into the void")

    got: list[bytes] = []
    receiver = LocalReceiver(address)
    receiver.expect(1, got.append)
    assert sender.connect()
    sender.send(b"hello again")

    assert drained(receiver, got, 1) == [b"hello again"]
    sender.close()
    receiver.close()


def test_a_link_that_names_no_edge_is_closed(address: Path) -> None:
    receiver, got = LocalReceiver(address), []
    receiver.expect(1, got.append)
    unknown = LocalSender([(99, address)])
    unknown.connect()
    unknown.send(b"let me in")
    known = LocalSender([(1, address)])
    known.connect()
    known.send(b"as agreed")

    assert drained(receiver, got, 1) == [b"as agreed"]
    unknown.send(b"let me in")
    assert unknown.connect()  # its first link was closed
    known.close()
    unknown.close()
    receiver.close()


def test_any_thread_may_wake_the_waiting_one(address: Path) -> None:
    receiver = LocalReceiver(address)
    receiver.wake()
    began = time.monotonic()

    receiver.wait(120)

    assert time.monotonic() - began < 60
    receiver.close()
    assert not address.exists()
