"""The local transport delivers whole packets in order, and no reader can block a writer."""

import socket
import time
from pathlib import Path

import pytest

from pipeline.bus.local_transport import MOST_ROUNDS, LocalReceiver, LocalSender, Target
from pipeline.bus.outport import MOST_PACKET_BYTES


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


def test_the_largest_packet_of_a_writer_arrives_whole(address: Path) -> None:
    receiver, got = LocalReceiver(address), []
    receiver.expect(1, got.append)
    sender, packet = LocalSender([(1, address)]), bytes(range(256)) * (MOST_PACKET_BYTES // 256)
    assert sender.connect()

    assert sender.send(packet) == []

    assert drained(receiver, got, 1) == [packet]
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


def test_the_last_packets_of_a_predecessor_are_read_before_those_of_its_successor(
    address: Path,
) -> None:
    receiver, got = LocalReceiver(address), []
    receiver.expect(1, got.append)
    senders = [LocalSender([(1, address)]) for _ in range(2)]
    for sender in senders:
        assert sender.connect()
        receiver.wait(60)  # the order of the links is that of their first packets

    predecessor, successor = senders
    successor.send(b"third")
    predecessor.send(b"first")
    predecessor.send(b"second")

    assert drained(receiver, got, 3) == [b"first", b"second", b"third"]
    for sender in senders:
        sender.close()
    receiver.close()


def test_a_flood_of_packets_does_not_hold_up_what_waits_for_them(address: Path) -> None:
    receiver, sender, got = LocalReceiver(address), LocalSender([(1, address)]), []

    def flood(packet: bytes) -> None:
        got.append(packet)
        if len(got) < 10 * MOST_ROUNDS:
            sender.send(packet)

    receiver.expect(1, flood)
    assert sender.connect()
    sender.send(b"again")

    receiver.wait(60)

    assert 0 < len(got) <= MOST_ROUNDS
    sender.close()
    receiver.close()


def test_a_reader_beside_the_others_is_not_waited_for_and_gets_what_they_get(
    short_path: Path,
) -> None:
    first, second = (LocalReceiver(short_path / f"{name}.recv") for name in ("one", "two"))
    got: list[bytes] = []
    for receiver in (first, second):
        receiver.expect(1, got.append)
    sender = LocalSender()
    sender.set_targets([(1, short_path / "one.recv")], [(1, short_path / "two.recv")])
    assert sender.connect()
    assert sender.send(b"packet") == []
    assert drained(first, got, 1) == [b"packet"]
    assert drained(second, got, 2) == [b"packet"] * 2

    full: set[Target] = set()
    for _ in range(5000):
        full.update(sender.send(b"x" * 1000))
        first.wait(0)  # only the second one stands still

    assert full == set()
    for end in (sender, first, second):
        end.close()


@pytest.mark.parametrize("first", [b"", b"\1", b"\1\0\0\0\0", b"\1" * 5000])
def test_a_link_that_begins_with_anything_else_is_closed(address: Path, first: bytes) -> None:
    receiver, got = LocalReceiver(address), []
    receiver.expect(1, got.append)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stranger:
        stranger.connect(str(address))
        stranger.send(first)
        stranger.settimeout(60)

        receiver.wait(60)  # for the link and its packet, both of which are there

        assert stranger.recv(1) == b""
    assert got == []
    receiver.close()


def test_any_thread_may_wake_the_waiting_one(address: Path) -> None:
    receiver = LocalReceiver(address)
    receiver.wake()
    began = time.monotonic()

    receiver.wait(120)

    assert time.monotonic() - began < 60
    receiver.close()
    assert not address.exists()
