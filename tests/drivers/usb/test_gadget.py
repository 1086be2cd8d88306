"""A virtual board on its way to a kernel: descriptors, streams on end points, what is refused.

That a kernel takes it is tested in a guest, see test_attached.py.
"""

import os
import select
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.usb.frame_header import HEADER_BYTES, FrameHeader, Stream
from drivers.usb.requests import Request
from drivers.virtual_board.board import VirtualBoard
from drivers.virtual_board.end_point import WAKE, EndPoint, StreamWriter
from drivers.virtual_board.function_fs import FULL, HIGH, SUPER, descriptor_block
from drivers.virtual_board.gadget_configuration import GadgetConfiguration
from pipeline.errors import DriverError
from tests.drivers.usb.boards import configured

LIMIT_S = 20.0


def test_the_kernel_is_told_the_interface_at_each_speed() -> None:
    block = descriptor_block()
    magic, length, flags, *counts = np.frombuffer(block[:24], "<u4").tolist()
    kinds, packets, rest = [], [], block[24:]
    while rest:
        kinds.append(rest[1])
        if rest[1] == 5:
            packets.append((rest[2], rest[3], int.from_bytes(rest[4:6], "little")))
        else:
            assert rest[1] != 4 or rest[4:8] == bytes([2, 0xFF, 0xFE, 1])
        rest = rest[rest[0] :]

    assert (magic, length, flags) == (3, len(block), FULL | HIGH | SUPER)
    assert (counts, kinds) == ([3, 3, 5], [4, 5, 5, 4, 5, 5, 4, 5, 0x30, 5, 0x30])
    assert packets == [(0x81 + k, 2, size) for size in (64, 512, 1024) for k in range(2)]


@pytest.mark.parametrize(("controller", "left"), [("a.usb", True), ("", False)])
def test_what_a_gadget_that_runs_has_mounted_stays_mounted(
    tmp_path: Path, controller: str, left: bool
) -> None:
    (tmp_path / "usb_gadget" / "fovea").mkdir(parents=True)
    (tmp_path / "usb_gadget" / "fovea" / "UDC").write_text(f"{controller}\n")
    mounted, of_another = tmp_path / "fovea-gadget-1", tmp_path / "another"
    mounts = tmp_path / "mounts"
    mounts.write_text("".join(f"fovea {p} functionfs rw 0 0\n" for p in (mounted, of_another)))
    for folder in (mounted, of_another):
        folder.mkdir()  # removed where it is unmounted

    with pytest.raises(DriverError, match="expected a name that no gadget has"):
        GadgetConfiguration("fovea", config_fs=tmp_path, mounts=mounts).make("1")

    assert (mounted.exists(), of_another.exists()) == (left, True)


class Recording(EndPoint):
    """An end point whose host takes everything; `sent` has the length of each write."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.halts = 0
        self.changed = threading.Condition()

    def packet_bytes(self) -> int:
        return 1024

    def write(self, data: NDArray[np.uint8]) -> None:
        with self.changed:
            self.sent.append(data.tobytes())
            self.changed.notify_all()

    def halt(self) -> None:
        self.halts += 1

    def close(self) -> None: ...

    def lengths(self, count: int) -> list[int]:
        """Return the lengths of the first writes, once there are so many."""
        with self.changed:
            assert self.changed.wait_for(lambda: len(self.sent) >= count, LIMIT_S)
            return [len(one) for one in self.sent[:count]]


class Fifo(EndPoint):
    """An end point whose host takes 64 KiB, and then nothing."""

    def packet_bytes(self) -> int:
        return 1024


def writing(
    subject: VirtualBoard, end_point: EndPoint, ended: Callable[[], None] = lambda: None
) -> StreamWriter:
    return StreamWriter(subject, Stream.ROI, end_point, ended)


@pytest.fixture(autouse=True)
def _wakes() -> Iterator[None]:
    before = signal.signal(WAKE, lambda _number, _frame: None)
    yield
    signal.signal(WAKE, before)


def test_headers_and_payloads_are_transfers_of_their_own() -> None:
    subject, end_point = configured(), Recording()
    writer = writing(subject, end_point)

    writer.go()
    for _ in range(2):
        subject.tell(Request.TRIGGER, 0, b"")
    end_point.lengths(4)
    writer.close()

    headers = [FrameHeader.unpack(one) for one in end_point.sent[0:4:2]]
    assert [header.exposure for header in headers] == [0, 1]
    assert [header.payload_bytes for header in headers] == end_point.lengths(4)[1::2]


@pytest.mark.parametrize("size_px", [(320, 192), (2048, 1024)])
def test_a_payload_that_ends_early_shows_its_end(size_px: tuple[int, int]) -> None:
    subject = configured(size_px=size_px, faults=({"kind": "truncate", "exposure": 0},))
    end_point = Recording()
    writer = writing(subject, end_point)

    writer.go()
    for _ in range(2):
        subject.tell(Request.TRIGGER, 0, b"")
    while [len(one) for one in end_point.sent].count(HEADER_BYTES) < 2:
        end_point.lengths(len(end_point.sent) + 1)
    writer.close()

    lengths = [len(one) for one in end_point.sent]
    payload = lengths[1 : lengths.index(HEADER_BYTES, 1)]
    assert sum(payload) == FrameHeader.unpack(end_point.sent[0]).payload_bytes // 2
    assert payload[-1] % 1024 or not payload[-1]
    assert all(length % 1024 == 0 for length in payload[:-1])


def test_a_stall_halts_the_end_point_and_a_header_follows() -> None:
    subject = configured(faults=({"kind": "stall", "exposure": 0},))
    end_point = Recording()
    writer = writing(subject, end_point)

    writer.go()
    for _ in range(2):
        subject.tell(Request.TRIGGER, 0, b"")
    end_point.lengths(2)
    writer.close()

    headers = [one for one in end_point.sent if len(one) == HEADER_BYTES]
    assert end_point.halts == 1
    assert [FrameHeader.unpack(header).exposure for header in headers[:2]] == [0, 1]


def test_what_the_host_did_not_take_is_dropped_by_a_stop(tmp_path: Path) -> None:
    path = tmp_path / "end_point"
    os.mkfifo(path)
    subject = configured(size_px=(2048, 1024))
    writer = writing(subject, Fifo(path))
    host = os.open(path, os.O_RDONLY | os.O_NONBLOCK)

    writer.go()
    subject.tell(Request.TRIGGER, 0, b"")
    first = _read(host, HEADER_BYTES)
    subject.tell(Request.STOP, 0, b"")
    writer.park()
    while _some(host, 1 << 20):
        pass
    subject.tell(Request.START, 1, b"")
    for _ in range(3):
        subject.tell(Request.TRIGGER, 0, b"")
    writer.go()
    second = _read(host, HEADER_BYTES)
    writer.close()
    os.close(host)

    headers = [FrameHeader.unpack(block) for block in (first, second)]
    assert [header.exposure for header in headers] == [0, 0]
    assert headers[1].stamp_ns > headers[0].stamp_ns


def test_a_writer_notices_that_the_board_is_unplugged() -> None:
    subject = configured(faults=({"kind": "unplug", "exposure": 0, "seconds": 60.0},))
    ended = threading.Event()
    writer = writing(subject, Recording(), ended.set)

    writer.go()
    subject.tell(Request.TRIGGER, 0, b"")
    assert ended.wait(LIMIT_S)
    noticed = writer.gone
    writer.close()

    assert noticed


def test_a_read_that_waits_ends_when_the_board_is_stopped() -> None:
    subject, answers = configured(), []
    memory = np.empty(1024, np.uint8)
    reader = threading.Thread(
        target=lambda: answers.append(subject.read(Stream.ROI, memory, 10 * LIMIT_S))
    )
    reader.start()
    subject.tell(Request.STOP, 0, b"")
    reader.join(LIMIT_S)
    subject.tell(Request.START, 1, b"")

    assert not reader.is_alive()
    assert answers == [None]


def _some(host: int, most: int) -> bytes:
    try:
        return os.read(host, most)
    except BlockingIOError:
        return b""


def _read(host: int, count: int) -> bytes:
    found, deadline_s = b"", time.monotonic() + LIMIT_S
    while len(found) < count:
        assert select.select([host], [], [], deadline_s - time.monotonic())[0], "nothing came"
        found += _some(host, count - len(found))
    return found
