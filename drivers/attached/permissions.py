"""Devices on USB that this user may not open: the kernel's list in, names and remedies out.

libusb and Aravis leave out, or cannot name, what they may not open.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from drivers.attached.listing import AttachedSensor
from drivers.attached.rules import REMEDY
from drivers.board_ids import PRODUCT_ID, VENDOR_ID
from pipeline.text import harmless

SYSTEM = Path("/sys/bus/usb/devices")
NODES = Path("/dev/bus/usb")
VISION = ("ef", "05")  # interface class and subclass of USB3 Vision
MOST_CHARS = 60


@dataclass(frozen=True, kw_only=True)
class UsbDevice:
    """A device as the kernel lists it."""

    product: str
    where: str  # bus.address, as `fovea sensors` writes it
    node: Path  # what is opened
    board: bool  # by its ids
    vision: bool  # by the class of one of its interfaces

    @property
    def problem(self) -> str:
        """Why it cannot be opened, in one sentence; empty: it can."""
        if not self.node.exists():
            return f"usb {self.where}: {self.node} is not there (a container without it?)"
        if not os.access(self.node, os.R_OK | os.W_OK):
            return f"usb {self.where}: no permission to open {self.node}"
        return ""


def usb_devices(system: Path = SYSTEM, nodes: Path = NODES) -> Iterator[UsbDevice]:
    """Yield the boards and USB3 Vision cameras on the bus, also those that may not be opened."""
    for folder in sorted(system.glob("*-*")):
        bus, address = (_number(folder / name) for name in ("busnum", "devnum"))
        if not (bus and address):  # an interface, or a device that has just gone
            continue
        ids = tuple(_text(folder / name) for name in ("idVendor", "idProduct"))
        classes = [
            (_text(part / "bInterfaceClass"), _text(part / "bInterfaceSubClass"))
            for part in folder.glob(f"{folder.name}:*")
        ]
        found = UsbDevice(
            product=harmless(_text(folder / "product"), MOST_CHARS),
            where=f"{bus}.{address}",
            node=nodes / f"{bus:03d}" / f"{address:03d}",
            board=ids == (f"{VENDOR_ID:04x}", f"{PRODUCT_ID:04x}"),
            vision=VISION in classes,
        )
        if found.board or found.vision:
            yield found


def hidden_cameras(system: Path = SYSTEM, nodes: Path = NODES) -> Iterator[AttachedSensor]:
    """Yield the USB3 Vision cameras that this user may not open."""
    for device in usb_devices(system, nodes):
        if device.vision and device.problem:
            yield AttachedSensor(
                name=f"genicam:usb-{device.where}",
                title=device.product or "a USB3 Vision camera",
                where=f"usb {device.where}",
                problem=device.problem,
                remedy=REMEDY if device.node.exists() else "",
            )


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()[:MOST_CHARS]
    except OSError:
        return ""


def _number(path: Path) -> int:
    text = _text(path)
    return int(text) if text.isdecimal() else 0
