"""Programs that attach a virtual board, and USB/IP: ports, options, cancelled reads."""

import socket
import threading
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivers.usb import link
from drivers.usb.frame_header import HEADER_BYTES, Stream
from drivers.usb.requests import Request
from drivers.virtual_board import VirtualBackend, gadget, usbip
from drivers.virtual_board.board import VirtualBoard
from drivers.virtual_board.gadget_configuration import GadgetConfiguration, controller_of
from pipeline.errors import DriverError, FoveaError
from tests.drivers.usb.boards import board, configured

LIMIT_S = 20.0


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
    subject = configured()
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
