"""Boards for tests: the driver over a virtual board that looks at a small moving square."""

from typing import Any

from drivers.sensor import Exposure
from drivers.usb import DualStreamBoard, DualStreamBoardSettings
from drivers.virtual_board import VirtualBackend, VirtualBoardSettings
from tests.drivers.contract import memory

SQUARE = "tests.drivers.moving_square:MovingSquare"
BACKEND = "drivers.virtual_board:VirtualBackend"
VIRTUAL = {"scene": SQUARE, "size_px": (320, 192), "frames": 40}


def board(virtual: dict[str, Any] | None = None, **settings: Any) -> DualStreamBoard:
    """Return the driver, not yet open."""
    values: dict[str, Any] = {"rate_hz": 100.0, "backend": BACKEND, **settings}
    values.setdefault("backend_options", {**VIRTUAL, **(virtual or {})})
    return DualStreamBoard(DualStreamBoardSettings(**values))


def backend(**virtual: Any) -> VirtualBackend:
    """Return a bus with a virtual board."""
    return VirtualBackend(VirtualBoardSettings(**{**VIRTUAL, **virtual}))


def played(subject: DualStreamBoard, *, realtime: bool = False) -> list[Exposure]:
    """Return all exposures until the end."""
    subject.open(realtime=realtime)
    subject.start()
    exposures = []
    try:
        while (exposure := subject.read(memory)) is not None:
            exposures.append(exposure)
    finally:
        subject.close()
    return exposures
