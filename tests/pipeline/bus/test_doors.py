"""The short way: packets whole and in order, no reader can hold a writer up."""

import time
from pathlib import Path

import pytest

from pipeline.bus.doors import Doors, Links


@pytest.fixture
def address(short_path: Path) -> Path:
    return short_path / "node.door"


def drained(doors: Doors, got: list[bytes], count: int) -> list[bytes]:
    deadline = time.monotonic() + 60
    while len(got) < count and time.monotonic() < deadline:
        doors.wait(0.05)
    return got


def test_packets_arrive_whole_and_in_order(address: Path) -> None:
    doors, got = Doors(address), []
    doors.expect(7, got.append)
    links = Links([(7, address)])
    assert links.connect()
    packets = [bytes([i]) * (1 + 997 * i) for i in range(40)]

    for number, packet in enumerate(packets):
        links.send(packet)
        drained(doors, got, number - 2)  # a few are always under way

    assert drained(doors, got, 40) == packets
    links.close()
    doors.close()


def test_a_writer_never_waits_for_a_reader_that_stands_still(address: Path) -> None:
    doors, got = Doors(address), []
    doors.expect(1, got.append)
    links = Links([(1, address)])
    links.connect()

    full = [links.send(b"x" * 1000) for _ in range(5000)]

    assert full[0] == []
    assert full[-1] == [(1, address)]
    arrived = sum(lost == [] for lost in full)
    assert 50 < arrived < 5000
    assert len(drained(doors, got, arrived)) == arrived
    links.close()
    doors.close()


def test_a_reader_that_comes_back_is_found_again(address: Path) -> None:
    doors = Doors(address)
    doors.expect(1, lambda _packet: None)
    links = Links([(1, address)])
    assert links.connect()
    assert not links.connect()
    doors.close()
    links.send(b"into the void")

    got: list[bytes] = []
    doors = Doors(address)
    doors.expect(1, got.append)
    assert links.connect()
    links.send(b"hello again")

    assert drained(doors, got, 1) == [b"hello again"]
    links.close()
    doors.close()


def test_a_link_that_names_no_edge_is_closed(address: Path) -> None:
    doors, got = Doors(address), []
    doors.expect(1, got.append)
    stranger = Links([(99, address)])
    stranger.connect()
    stranger.send(b"let me in")
    known = Links([(1, address)])
    known.connect()
    known.send(b"as agreed")

    assert drained(doors, got, 1) == [b"as agreed"]
    stranger.send(b"let me in")
    assert stranger.connect()  # its first link was closed
    known.close()
    stranger.close()
    doors.close()


def test_any_thread_may_wake_the_waiting_one(address: Path) -> None:
    doors = Doors(address)
    doors.wake()
    began = time.monotonic()

    doors.wait(120)

    assert time.monotonic() - began < 60
    doors.close()
    assert not address.exists()
