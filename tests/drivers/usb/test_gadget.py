"""A virtual board on its way to a kernel: descriptors, streams on end points, what is refused.

That a kernel takes it is tested in a guest, see test_attached.py.
"""

import os
import select
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from drivers.usb import link
from drivers.usb.frame_header import HEADER_BYTES, FrameHeader, Stream
from drivers.usb.requests import Configuration, Request
from drivers.virtual_board import VirtualBackend, gadget, usbip
from drivers.virtual_board.board import VirtualBoard
from drivers.virtual_board.end_point import WAKE, EndPoint, StreamWriter
from drivers.virtual_board.function_fs import FULL, HIGH, SUPER, descriptor_block
from drivers.virtual_board.gadget_configuration import GadgetConfiguration, controller_of
from pipeline.errors import DriverError, FoveaError
from tests.drivers.usb.boards import backend, board

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


def started(**virtual: Any) -> VirtualBoard:
    """Return a board that waits for TRIGGER."""
    found = backend(**virtual).board
    size = found.profile.can.roi_sizes[0]
    configuration = Configuration(
        rate_mhz=10_000, roi_px=(size.width_px, size.height_px), payload_crc=True,
        pixel_format=found.profile.can.formats[0],
    )  # fmt: skip
    found.tell(Request.CONFIGURE, 0, configuration.pack())
    found.tell(Request.START, 1, b"")
    return found


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
    subject, end_point = started(), Recording()
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
    subject = started(size_px=size_px, faults=({"kind": "truncate", "exposure": 0},))
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
    subject = started(faults=({"kind": "stall", "exposure": 0},))
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
    subject = started(size_px=(2048, 1024))
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
    subject = started(faults=({"kind": "unplug", "exposure": 0, "seconds": 60.0},))
    ended = threading.Event()
    writer = writing(subject, Recording(), ended.set)

    writer.go()
    subject.tell(Request.TRIGGER, 0, b"")
    assert ended.wait(LIMIT_S)
    noticed = writer.gone
    writer.close()

    assert noticed


def test_a_read_that_waits_ends_when_the_board_is_stopped() -> None:
    subject, answers = started(), []
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


def test_a_port_or_gadget_that_cannot_be_is_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "udc" / "a.usb").mkdir(parents=True)
    taken = tmp_path / "usb_gadget" / "fovea"
    taken.mkdir(parents=True)
    (taken / "UDC").write_text("a.usb\n")

    assert controller_of(controllers=tmp_path / "udc") == "a.usb"
    (tmp_path / "udc" / "b.usb").mkdir()
    for act, said in (
        (lambda: controller_of(controllers=tmp_path / "none"), "no USB device controller"),
        (lambda: controller_of(controllers=tmp_path / "udc"), "a.usb, b.usb, got none"),
        (lambda: controller_of("c", controllers=tmp_path / "udc"), "a.usb, b.usb, got c"),
        (lambda: GadgetConfiguration("../x"), "expected 1 to 32 letters"),
        (lambda: GadgetConfiguration("x", config_fs=tmp_path / "none").make("1"), "modprobe"),
        (lambda: GadgetConfiguration("fovea", config_fs=tmp_path).make("1"), "one at a.usb"),
    ):
        with pytest.raises(FoveaError, match=said):
            act()


def test_the_first_free_superspeed_port_is_taken(tmp_path: Path) -> None:
    ports = [("hs", 0, "004"), ("ss", 15, "006"), ("ss", 16, "004"), ("ss", 17, "004")]
    (tmp_path / "status").write_text(
        "hub port sta spd dev      sockfd local_busid\n"
        + "".join(f"{hub}  {n:04} {state} 000 00000000 000000 0-0\n" for hub, n, state in ports)
    )

    assert (usbip.free_port(None, tmp_path), usbip.free_port(17, tmp_path)) == (16, 17)
    with pytest.raises(DriverError, match=r"expected a free SuperSpeed port, \[16, 17\], got 0"):
        usbip.free_port(0, tmp_path)
    with pytest.raises(DriverError, match="modprobe vhci_hcd"):
        usbip.free_port(None, tmp_path / "none")


@pytest.mark.parametrize("program", [gadget.main, usbip.main])
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--fault", "stall"], "--fault: expected KIND:EXPOSURE[:STREAM[:SECONDS]], got stall"),
        (["--fault", "stall:x"], "got stall:x"),
        (["--fault", "stall:1:roi:0.5:9"], "got stall:1:roi:0.5:9"),
        (["--fault", "burn:1"], "faults[0].kind: input should be "),
        (["--profile", "none"], "profile: expected "),
        (["--size", "3", "5"], "size_px: expected multiples of 16"),
    ],
)
def test_a_wrong_option_is_refused_in_a_sentence(
    program: Any, options: list[str], said: str
) -> None:
    result = CliRunner().invoke(program, options)

    assert result.exit_code == 1
    assert said in result.output
    assert len(result.output.splitlines()) == 1


class Deaf(VirtualBackend):
    """A bus with a board that acknowledges configurations and does not take them."""

    def ctrl_transfer(
        self, dev_handle: Any, kind: int, request: int, value: int, index: int, data: Any,
        timeout: int,
    ) -> int:  # fmt: skip
        if request == Request.CONFIGURE:
            return len(data)
        return super().ctrl_transfer(dev_handle, kind, request, value, index, data, timeout)


def test_a_configuration_that_was_not_taken_is_an_error() -> None:
    subject = board(backend=f"{__name__}:Deaf")

    subject.open(realtime=False)
    with pytest.raises(DriverError, match="roi_px: expected"):
        subject.start()
    subject.close()


class Overtaken(usbip.UsbIpDevice):
    """A device that is told to cancel a read while it answers it."""

    def __init__(self, subject: VirtualBoard, link: socket.socket) -> None:
        super().__init__(subject, link)
        self.answers: list[int] = []
        self._cancelling: list[threading.Thread] = []

    def _answer(
        self, command: int, number: int, rest: bytes, data: bytes | memoryview = b""
    ) -> None:
        if command == usbip.SUBMITTED:
            thread = threading.Thread(target=self._unlink, args=(number + 1, number))
            thread.start()
            self._cancelling.append(thread)
            thread.join(0.2)  # it waits until the read is answered
        self.answers.append(command)
        super()._answer(command, number, rest, data)

    def wait(self) -> None:
        """Wait until what cancels is answered."""
        for thread in self._cancelling:
            thread.join(LIMIT_S)


def test_a_read_that_is_cancelled_too_late_is_answered_before_the_cancelling() -> None:
    subject = started()
    subject.tell(Request.TRIGGER, 0, b"")
    ours, kernels = socket.socketpair()
    device = Overtaken(subject, ours)
    server = threading.Thread(target=device.serve)
    server.start()

    roi, length = int(Stream.ROI) + 1, 1024
    head = usbip.BASIC.pack(usbip.SUBMIT, 7, 0, usbip.IN, roi)
    kernels.sendall(head + usbip.COMMAND.pack(0, length, 0, 0, 0, bytes(8)))
    found = kernels.recv(2 * usbip.HEADER_BYTES + HEADER_BYTES, socket.MSG_WAITALL)
    device.wait()
    kernels.close()
    server.join(LIMIT_S)

    assert len(found) == 2 * usbip.HEADER_BYTES + HEADER_BYTES
    assert device.answers == [usbip.SUBMITTED, usbip.UNLINKED]


class _Freed:
    """Says when it is freed, as the wrappers of libusb's objects give them back."""

    def __init__(self, name: str, freed: list[str]) -> None:
        self._name, self._freed = name, freed

    def __del__(self) -> None:
        self._freed.append(self._name)


def test_a_context_of_libusb_is_freed_after_its_devices() -> None:
    freed: list[str] = []
    context, device = _Freed("context", freed), _Freed("device", freed)
    held = {"context": context, "device": device}  # dropped in this order, as in pyusb
    link.outlive(device, context)

    del context, device
    held.clear()

    assert freed == ["device", "context"]


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
