"""A virtual board as a USB/IP device: a real kernel enumerates it, a real libusb reads from it.

    python -m drivers.virtual_board.usbip --scene soccer     (as root, with the module vhci_hcd)

The kernel's virtual host controller gets one end of a socket pair, this program answers at the
other one. Packets are those of the kernel's Documentation/usb/usbip_protocol.rst; they are
big-endian.
"""

import errno
import logging
import queue
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import click
import numpy as np
from numpy.typing import NDArray

from drivers.usb.frame_header import Stream
from drivers.virtual_board.backend import VirtualBackend
from drivers.virtual_board.board import VirtualBoard
from drivers.virtual_board.command_line import board_options, board_settings
from drivers.virtual_board.descriptors import ENDPOINTS, standard_answer
from drivers.virtual_board.errors import Gone, Halted, Refused, TooMuch
from drivers.virtual_board.setup_packet import ENDPOINT, SetupPacket
from pipeline.errors import DriverError, FoveaError

CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
SUPER_SPEED = 5
SUPER_SPEED_HUB, FREE = "ss", "004"  # hub and state of a port in the controller's status
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
BASIC = struct.Struct(">IIIII")  # command, number, device, direction, end point
COMMAND = struct.Struct(">IiiiI8s")  # flags, length, start frame, packets, interval, setup
ANSWER = struct.Struct(">iiiii8x")  # status, length, start frame, packets, errors
UNLINK_ANSWER = struct.Struct(">i24x")
HEADER_BYTES = 48
MOST_TRANSFER_BYTES = 64 << 20
IN = 1
POLL_S = 0.05  # how soon a cancelled read is noticed
FREED_S = 10.0  # in which the controller has to notice that a device is gone
CLEAR_FEATURE = 1

T = TypeVar("T")
log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Read:
    """A bulk read that the kernel waits for."""

    number: int
    length: int
    begun: bool = False
    unlink: int = 0  # number of the command that cancels it; 0: none


class UsbIpDevice:
    """Answers one kernel over one socket until it is closed."""

    def __init__(self, board: VirtualBoard, link: socket.socket) -> None:
        self._board, self._link = board, link
        self._writing = threading.Lock()
        self._reads: dict[Stream, queue.Queue[_Read | None]] = {s: queue.Queue() for s in Stream}
        self._waiting: dict[int, _Read] = {}
        self._guard = threading.Lock()

    def serve(self) -> None:
        """Answer until the kernel detaches the device or the board is unplugged."""
        times = self._board.plugged_in
        threads = [threading.Thread(target=self._stream, args=(s,), daemon=True) for s in Stream]
        for thread in threads:
            thread.start()
        try:
            while self._board.plugged_in == times:
                command, number, _, direction, end_point = BASIC.unpack(self._taken(BASIC.size))
                rest = self._taken(HEADER_BYTES - BASIC.size)
                if command == UNLINK:
                    self._unlink(number, struct.unpack_from(">I", rest)[0])
                elif command == SUBMIT:
                    self._submit(number, direction, end_point, rest)
                else:
                    raise DriverError(f"usbip: the kernel sent the command {command}")
        except (ConnectionError, OSError) as error:
            log.info("usbip: detached: %s", error)
        finally:
            self._link.close()
            for stream in Stream:
                self._reads[stream].put(None)

    def _submit(self, number: int, direction: int, end_point: int, rest: bytes) -> None:
        _, length, _, _, _, setup = COMMAND.unpack(rest)
        if not 0 <= length <= MOST_TRANSFER_BYTES:
            raise DriverError(f"usbip: the kernel asked for {length} bytes")
        if end_point:
            read = _Read(number, length)
            with self._guard:
                self._waiting[number] = read
            self._reads[Stream(end_point - 1)].put(read)
            return
        data = b"" if direction == IN else self._taken(length)
        status, answer = _attempt(lambda: self._control(SetupPacket.unpack(setup), data))
        sent = len(answer) if direction == IN else len(data)
        self._answer(SUBMITTED, number, ANSWER.pack(status, sent, 0, 0, 0), answer)

    def _control(self, setup: SetupPacket, data: bytes) -> bytes:
        if setup.vendor:
            if setup.reads:
                return self._board.ask(setup.request, setup.length)
            self._board.tell(setup.request, setup.value, data)
            return b""
        if setup.request == CLEAR_FEATURE and setup.recipient == ENDPOINT:
            addresses = [e["bEndpointAddress"] for e in ENDPOINTS]
            self._board.clear_halt(Stream(addresses.index(setup.index & 0xFF)))
            return b""
        return standard_answer(setup.kind, setup.request, setup.value, setup.length)

    def _unlink(self, number: int, wanted: int) -> None:
        """Cancel a read; one that has begun says itself whether it still got its bytes."""
        with self._guard:
            read = self._waiting.get(wanted)
            if read is not None and read.begun:
                read.unlink = number
                return
            self._waiting.pop(wanted, None)
            status = 0 if read is None else -errno.ECONNRESET
            self._answer(UNLINKED, number, UNLINK_ANSWER.pack(status))

    def _stream(self, stream: Stream) -> None:
        """Answer the reads of one end point, one after the other."""
        while (read := self._reads[stream].get()) is not None:
            with self._guard:
                if read.number not in self._waiting:
                    continue  # it was cancelled, and that is answered
                read.begun = True
            memory = np.empty(read.length, np.uint8)
            count: int | None = None
            status = 0
            while count is None and status == 0 and not read.unlink:
                status, count = _tried(partial(self._board.read, stream, memory, POLL_S))
            if status == -errno.ENODEV:  # the cable is pulled: the kernel notices by the socket
                with suppress(OSError):  # it has noticed
                    self._link.shutdown(socket.SHUT_RDWR)
                return
            self._answer_read(read, status, count, memory)

    def _answer_read(
        self, read: _Read, status: int, count: int | None, memory: NDArray[np.uint8]
    ) -> None:
        """Answer a read, and then the command that cancels it.

        Both while no other command is looked at: the kernel drops the device when it is answered
        the read after one that cancels it.
        """
        with self._guard:
            self._waiting.pop(read.number, None)
            if read.unlink and count is None and not status:
                self._answer(UNLINKED, read.unlink, UNLINK_ANSWER.pack(-errno.ECONNRESET))
                return
            sent = count or 0
            self._answer(
                SUBMITTED, read.number, ANSWER.pack(status, sent, 0, 0, 0), memory[:sent].data
            )
            if read.unlink:
                self._answer(UNLINKED, read.unlink, UNLINK_ANSWER.pack(0))

    def _answer(
        self, command: int, number: int, rest: bytes, data: "bytes | memoryview" = b""
    ) -> None:
        with self._writing:
            try:
                self._link.sendall(BASIC.pack(command, number, 0, 0, 0) + rest)
                if len(data):
                    self._link.sendall(data)
            except OSError as error:
                log.info("usbip: detached: %s", error)

    def _taken(self, count: int) -> bytes:
        found = bytearray()
        while len(found) < count:
            more = self._link.recv(count - len(found))
            if not more:
                raise ConnectionError("the kernel closed the device")
            found += more
        return bytes(found)


def free_port(wanted: int | None = None, controller: Path = CONTROLLER) -> int:
    """Return the first free SuperSpeed port, or the wanted one; raises `DriverError`.

    Ports of the slower hub precede those, 15 or 8 of them, as the kernel was built. A SuperSpeed
    device on one of theirs is taken, but at another port than it is detached from.
    """
    free = [p.number for p in _ports(controller) if (p.hub, p.state) == (SUPER_SPEED_HUB, FREE)]
    if not free:
        raise DriverError(f"usbip: {controller}: no SuperSpeed port is free")
    if wanted not in (None, *free):
        raise DriverError(f"--port: expected a free SuperSpeed port, {free}, got {wanted}")
    return free[0] if wanted is None else wanted


def attach(link: socket.socket, port: int, controller: Path = CONTROLLER) -> None:
    """Give the kernel's virtual controller its end of a socket."""
    _tell(controller / "attach", f"{port} {link.fileno()} {1 << 16 | 2} {SUPER_SPEED}")


def detach(port: int, controller: Path = CONTROLLER) -> None:
    """Make the kernel drop the device of a port, as if its cable was pulled."""
    _tell(controller / "detach", str(port))


@dataclass(frozen=True)
class _Port:
    hub: str  # hs or ss: which speed it has
    number: int
    state: str


def _ports(controller: Path) -> Iterator[_Port]:
    """Yield what the controller says about its ports."""
    try:
        lines = (controller / "status").read_text().splitlines()
    except OSError as error:
        raise _refused(controller, error) from None
    for words in (line.split() for line in lines[1:]):  # the first one is a heading
        yield _Port(words[0], int(words[1]), words[2])


def _tell(file: Path, text: str) -> None:
    try:
        file.write_text(text)
    except OSError as error:
        raise _refused(file, error) from None


def _refused(file: Path, error: OSError) -> DriverError:
    why = {
        errno.ENOENT: "no virtual host controller; `modprobe vhci_hcd` makes one",
        errno.EACCES: "no permission; it takes root",
        errno.EINVAL: "no device is at that port",
    }
    return DriverError(f"usbip: {file}: {why.get(error.errno or 0, error.strerror)}")


def _attempt(act: Callable[[], bytes]) -> tuple[int, bytes]:
    status, answer = _tried(act)
    return status, answer or b""


def _tried(act: Callable[[], T]) -> tuple[int, T | None]:
    """Return 0 and the result, or a negative error number."""
    try:
        return 0, act()
    except Gone:
        return -errno.ENODEV, None
    except (Halted, Refused):
        return -errno.EPIPE, None
    except TooMuch:
        return -errno.EOVERFLOW, None


def serve(board: VirtualBoard, *, port: int) -> None:
    """Attach the board, and again whenever it is plugged in again; returns when detached."""
    times = 0
    while board.plugged_in > times:  # else it was the kernel that detached it
        times = board.plugged_in
        while not board.present:
            time.sleep(POLL_S)
        _await_free(port)
        _serve_once(board, port)


def _serve_once(board: VirtualBoard, port: int) -> None:
    ours, kernels = socket.socketpair()
    with ours:
        with kernels:
            attach(kernels, port)
        UsbIpDevice(board, ours).serve()


def _await_free(port: int, controller: Path = CONTROLLER) -> None:
    """Wait until the controller has noticed that a device is gone."""
    deadline_s = time.monotonic() + FREED_S
    while time.monotonic() < deadline_s:
        if any((found.number, found.state) == (port, FREE) for found in _ports(controller)):
            return
        time.sleep(POLL_S)
    raise DriverError(f"usbip: port {port} is not free again after {FREED_S:.0f} s")


@click.command()
@board_options
@click.option("--port", type=int, help="Of the virtual controller; else the first that is free.")
def main(port: int | None, **options: Any) -> None:
    """Attach a virtual board to this kernel until it is detached."""
    try:
        board = VirtualBackend(board_settings(**options)).board
        serve(board, port=free_port(port))
    except FoveaError as error:
        raise click.ClickException(str(error)) from None


if __name__ == "__main__":
    main()
