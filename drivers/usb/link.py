"""The USB link to a board: the only module that knows pyusb.

Errors of the library become errors of this module. Pixels are read straight into the memory that
is given, without a copy in user space.
"""

import array
import errno
import time
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import usb.backend.libusb1
import usb.core
import usb.util
from numpy.typing import NDArray

from drivers.board_ids import PRODUCT_ID, VENDOR_ID
from drivers.usb.errors import (
    LinkError,
    NoAnswer,
    NoUsbMemory,
    Overflow,
    Stalled,
    Unplugged,
)
from drivers.usb.part import Part
from drivers.usb.transfers import InFlight
from pipeline.errors import DriverError, InstallError

CHUNK_BYTES = 512 << 10  # of one bulk read
MOST_IN_FLIGHT = 24  # 12 of the 16 MiB that Linux grants all devices by default
VENDOR_IN, VENDOR_OUT = 0xC1, 0x41  # vendor requests to the interface
VENDOR_CLASS = 0xFF
KINDS = {3: "usb2", 4: "usb3.0", 5: "usb3.1"}  # of link, by libusb's speed: high, super, super plus


@dataclass(frozen=True, kw_only=True)
class Attached:
    """A board on the bus."""

    serial: str
    product: str
    where: str  # bus and address
    device: Any = field(repr=False, compare=False)


def attached(
    backend: Any = None, *, ids: tuple[int, int] = (VENDOR_ID, PRODUCT_ID)
) -> list[Attached]:
    """Return the boards on the bus; one that may not be opened has no serial number."""
    own = backend is None
    backend = _libusb() if own else backend
    devices = list(usb.core.find(True, backend=backend, idVendor=ids[0], idProduct=ids[1]))
    for device in devices if own else ():
        outlive(device._ctx.dev, backend)
    return [_described(device) for device in devices]


def outlive(device: Any, context: Any) -> None:
    """Keep a context of libusb until a device of it is gone.

    pyusb's devices drop their context before they give themselves back to it; where they are the
    last to hold it, libusb would read memory that is freed.
    """
    held = weakref.finalize(device, lambda _context: None, context)
    held.atexit = False  # pyusb's own finalizers are in order then


class Link:
    """An opened board with its interface claimed; `close` is safe after any outcome."""

    def __init__(self, board: Attached, *, in_flight: int) -> None:
        self._device, self._in_flight = board.device, in_flight
        self.where = board.where
        try:
            self._claim()
        except usb.core.USBError as error:
            usb.util.dispose_resources(self._device)
            raise self._refused(error) from None
        except BaseException:
            usb.util.dispose_resources(self._device)
            raise

    @property
    def kind(self) -> str:
        """The link as `pipeline.planner.links` names it; empty: libusb does not tell its speed."""
        return KINDS.get(self._device.speed or 0, "")

    @property
    def in_flight(self) -> int:
        """Reads that are in flight at a time at most; 1 where the library cannot do more."""
        return self._async.depth if self._async else 1

    def ask(self, request: int, length: int, *, timeout_s: float = 1.0) -> bytes:
        """Return the board's answer to a request, at most `length` bytes."""
        with _Errors(self.where):
            answer = self._device.ctrl_transfer(
                VENDOR_IN, request, 0, self._interface, length, round(timeout_s * 1000)
            )
        return bytes(answer)

    def tell(
        self, request: int, data: bytes = b"", *, value: int = 0, timeout_s: float = 1.0
    ) -> None:
        """Send a request; raises `Stalled` when the board refuses it."""
        with _Errors(self.where):
            self._device.ctrl_transfer(
                VENDOR_OUT, request, value, self._interface, data, round(timeout_s * 1000)
            )

    def receive(self, parts: Sequence[Part], timeout_s: float, ahead: Sequence[Part] = ()) -> None:
        """Fill parts until each is over or the time is; what is missing shows in `received`.

        `ahead` are those that follow: they are read as far as reads are free, so that the link need
        not wait for the next call. Their memory, and that of parts which are not over, may then be
        written until a call without them, `cancel` or `close`; without `ahead` nothing is written
        after the return, nor after an error. Raises `Unplugged`, `Stalled` or `Overflow`.
        """
        with _Errors(self.where):
            if self._async is not None:
                self._async.receive(parts, timeout_s, ahead)
            else:
                self._receive_in_turn(parts, timeout_s)

    def cancel(self, stream: int) -> None:
        """End the reads of a stream that are in flight; its memory is not written any more."""
        if self._async is not None:
            with _Errors(self.where):
                self._async.cancel(stream)

    def clear_halt(self, stream: int) -> None:
        """Let a stalled end point go on."""
        with _Errors(self.where):
            self._device.clear_halt(self._endpoints[stream])

    def reset(self) -> None:
        """Reset the device; raises `Unplugged` where it does not come back as it was."""
        with _Errors(self.where):
            self._device.reset()
            usb.util.claim_interface(self._device, self._interface)

    def close(self) -> None:
        """Release interface and device."""
        if self._async is not None:
            self._async.close()
        usb.util.dispose_resources(self._device)

    def _claim(self) -> None:
        self._async: InFlight | None = None
        interface = _vendor_interface(self._device, self.where)
        self._interface = interface.bInterfaceNumber
        self._endpoints = [
            e.bEndpointAddress
            for e in interface
            if usb.util.endpoint_direction(e.bEndpointAddress) == usb.util.ENDPOINT_IN
            and usb.util.endpoint_type(e.bmAttributes) == usb.util.ENDPOINT_TYPE_BULK
        ]
        if len(self._endpoints) < 2:
            raise DriverError(
                f"{self.where}: expected two bulk IN end points, got {len(self._endpoints)}"
            )
        usb.util.claim_interface(self._device, self._interface)
        library = getattr(self._device.backend, "lib", None)
        if library is not None and self._in_flight > 1:
            context = self._device._ctx
            self._async = InFlight(
                library, self._device.backend.ctx, context.handle.handle, self._endpoints,
                chunk_bytes=CHUNK_BYTES, depth=min(self._in_flight, MOST_IN_FLIGHT),
            )  # fmt: skip

    def _receive_in_turn(self, parts: Sequence[Part], timeout_s: float) -> None:
        deadline_s = time.monotonic() + timeout_s
        for part in parts:
            while not part.over:
                rest = part.memory[part.received : part.received + CHUNK_BYTES]
                left_s = max(deadline_s - time.monotonic(), 0.001)
                try:
                    count = self._device.read(
                        self._endpoints[part.stream], _Memory(rest), max(1, round(left_s * 1000))
                    )
                except usb.core.USBTimeoutError:
                    return
                part.received += count
                if count < len(rest):
                    # a read that times out after some bytes looks like one that ended short
                    part.short = time.monotonic() < deadline_s
                    break

    def _refused(self, error: Any) -> DriverError:
        why = {
            errno.EACCES: "no permission; `fovea sensors rules` prints the udev rule for it",
            errno.EBUSY: "in use by another process",
        }.get(error.errno, str(error))
        return DriverError(f"{self.where}: cannot be opened: {why}")


class _Memory(array.array):  # type: ignore[type-arg]
    """What pyusb takes for an array of its own, over memory of ours."""

    def __new__(cls, _memory: NDArray[np.uint8]) -> "_Memory":
        return super().__new__(cls, "B")  # type: ignore[return-value]

    def __init__(self, memory: NDArray[np.uint8]) -> None:
        self.memory = memory

    def buffer_info(self) -> tuple[int, int]:
        return self.memory.ctypes.data, len(self.memory)

    def __len__(self) -> int:
        return len(self.memory)


class _Errors:
    """Turns errors of the library into ours."""

    def __init__(self, where: str) -> None:
        self._where = where

    def __enter__(self) -> None: ...

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if isinstance(error, LinkError):
            raise type(error)(f"{self._where}: {error}") from None
        if isinstance(error, usb.core.USBTimeoutError):
            raise NoAnswer(f"{self._where}: no answer in time") from None
        if not isinstance(error, usb.core.USBError):
            return
        kind = {
            errno.ENODEV: Unplugged, errno.EIO: Unplugged, errno.ESHUTDOWN: Unplugged,
            errno.EPIPE: Stalled, errno.EOVERFLOW: Overflow, errno.ENOMEM: NoUsbMemory,
        }.get(error.errno or 0, LinkError)  # fmt: skip
        raise kind(f"{self._where}: {error.strerror or error}") from None


def _libusb() -> Any:
    """Return pyusb's backend with a fresh context: without udev, an old one sees no new device."""
    usb.backend.libusb1._lib_object = None
    backend = usb.backend.libusb1.get_backend()
    if backend is None:
        raise InstallError(
            "usb: expected the library libusb, got none: apt-get install libusb-1.0-0"
        )
    return backend


def _described(device: Any) -> Attached:
    where = f"usb {device.bus}.{device.address}"
    try:
        serial, product = device.serial_number or "", device.product or ""
    except (usb.core.USBError, ValueError):  # no permission to read them
        serial = product = ""
    finally:
        usb.util.dispose_resources(device)
    return Attached(serial=serial, product=product, where=where, device=device)


def _vendor_interface(device: Any, where: str) -> Any:
    for interface in device.get_active_configuration():
        if interface.bInterfaceClass == VENDOR_CLASS:
            return interface
    raise DriverError(f"{where}: it has no vendor interface")
