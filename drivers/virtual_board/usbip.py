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
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import click
import numpy as np

from drivers.usb.frame_header import Stream
from drivers.virtual_board.backend import VirtualBackend, VirtualBoardSettings
from drivers.virtual_board.board import VirtualBoard
from drivers.virtual_board.descriptors import ENDPOINTS, standard_answer
from drivers.virtual_board.errors import Gone, Halted, Refused, TooMuch
from pipeline.errors import DriverError, FoveaError

CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
SUPER_SPEED = 5
FREE = "004"  # state of a port in the controller's status
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
BASIC = struct.Struct(">IIIII")  # command, number, device, direction, end point
COMMAND = struct.Struct(">IiiiI8s")  # flags, length, start frame, packets, interval, setup
ANSWER = struct.Struct(">iiiii8x")  # status, length, start frame, packets, errors
UNLINK_ANSWER = struct.Struct(">i24x")
HEADER_BYTES = 48
MOST_TRANSFER_BYTES = 64 << 20
IN = 1
POLL_S = 0.05  # how soon a cancelled read is noticed
SETUP = struct.Struct("<BBHHH")
CLEAR_FEATURE, ENDPOINT = 1, 2
VENDOR = 0x40

T = TypeVar("T")
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Setup:
    """A control transfer's setup packet."""

    kind: int
    request: int
    value: int
    index: int
    length: int


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
        threads = [threading.Thread(target=self._stream, args=(s,), daemon=True) for s in Stream]
        for thread in threads:
            thread.start()
        try:
            while self._board.present:
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
        status, answer = _attempt(lambda: self._control(Setup(*SETUP.unpack(setup)), data))
        sent = len(answer) if direction == IN else len(data)
        self._answer(SUBMITTED, number, ANSWER.pack(status, sent, 0, 0, 0), answer)

    def _control(self, setup: Setup, data: bytes) -> bytes:
        if setup.kind & VENDOR:
            if setup.kind & 0x80:
                return self._board.ask(setup.request, setup.length)
            self._board.tell(setup.request, setup.value, data)
            return b""
        if setup.request == CLEAR_FEATURE and setup.kind & 0x1F == ENDPOINT:
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
            with self._guard:
                self._waiting.pop(read.number, None)
            if status == -errno.ENODEV:  # the cable is pulled: the kernel notices by the socket
                self._link.shutdown(socket.SHUT_RDWR)
                return
            if read.unlink and count is None and not status:
                self._answer(UNLINKED, read.unlink, UNLINK_ANSWER.pack(-errno.ECONNRESET))
                continue
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


def attach(link: socket.socket, port: int = 15, controller: Path = CONTROLLER) -> None:
    """Give the kernel's virtual controller its end of a socket; ports from 15 on are SuperSpeed."""
    try:
        (controller / "attach").write_text(f"{port} {link.fileno()} {1 << 16 | 2} {SUPER_SPEED}")
    except OSError as error:
        raise DriverError(
            f"usbip: {controller}: cannot attach: {error.strerror}; it takes root and "
            "`modprobe vhci_hcd`"
        ) from None


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


def detach(port: int = 15, controller: Path = CONTROLLER) -> None:
    """Make the kernel drop the device of a port, as if its cable was pulled."""
    (controller / "detach").write_text(str(port))


def serve(board: VirtualBoard, *, port: int = 15) -> None:
    """Attach the board, and again whenever it is plugged in again; returns when detached."""
    _serve_once(board, port)
    while board.plugged_in > 1 and _comes_back(board):
        _await_free(port)
        _serve_once(board, port)


def _serve_once(board: VirtualBoard, port: int) -> None:
    ours, kernels = socket.socketpair()
    with ours:
        with kernels:
            attach(kernels, port)
        UsbIpDevice(board, ours).serve()


def _comes_back(board: VirtualBoard) -> bool:
    """Wait for a board that was unplugged; False: it was the kernel that detached it."""
    was_away = False
    while not board.present:
        was_away = True
        time.sleep(POLL_S)
    return was_away


def _await_free(port: int, controller: Path = CONTROLLER) -> None:
    """Wait until the controller has noticed that a device is gone."""
    deadline_s = time.monotonic() + 10
    while time.monotonic() < deadline_s:
        for line in (controller / "status").read_text().splitlines()[1:]:
            words = line.split()
            if int(words[1]) == port and words[2] == FREE:
                return
        time.sleep(POLL_S)
    raise DriverError(f"usbip: port {port} is not free again after 10 s")


@click.command()
@click.option("--profile", default="ideal", show_default=True)
@click.option("--scene", default="soccer", show_default=True, help="Scene or import path.")
@click.option("--size", nargs=2, type=int, default=(0, 0), help="Width and height of the sensor.")
@click.option("--frames", default=0, help="Exposures until the end; 0: endless.")
@click.option("--fault", "faults", multiple=True, help="KIND:EXPOSURE[:STREAM[:SECONDS]]")
@click.option("--port", default=15, show_default=True, help="Of the virtual controller.")
def main(
    profile: str, scene: str, size: tuple[int, int], frames: int, faults: tuple[str, ...], port: int
) -> None:
    """Attach a virtual board to this kernel until it is detached."""
    settings = VirtualBoardSettings(
        profile=profile, scene=scene, size_px=size, frames=frames,
        faults=tuple(map(_fault, faults)),
    )  # fmt: skip
    try:
        serve(VirtualBackend(settings).board, port=port)
    except FoveaError as error:
        raise click.ClickException(str(error)) from None


def _fault(text: str) -> dict[str, object]:
    kind, exposure, *rest = text.split(":")
    names = ("stream", "seconds")
    values: dict[str, object] = dict(zip(names, rest, strict=False))
    if "seconds" in values:
        values["seconds"] = float(str(values["seconds"]))
    return {"kind": kind, "exposure": int(exposure), **values}


if __name__ == "__main__":
    main()
