"""Boards for tests: the driver over a virtual board that looks at a small moving square."""

from dataclasses import replace
from typing import Any

from drivers.sensor import Exposure
from drivers.usb import DualStreamBoard, DualStreamBoardSettings
from drivers.usb.frame_header import Window
from drivers.usb.requests import Configuration, Request
from drivers.virtual_board import VirtualBackend, VirtualBoardSettings
from drivers.virtual_board.board import VirtualBoard
from drivers.virtual_board.world import World
from tests.drivers.contract import memory
from tests.drivers.moving_square import MovingSquare

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


class StepOneBackend(VirtualBackend):
    """A bus with a virtual board whose windows start at any pixel."""

    def __init__(self, settings: VirtualBoardSettings) -> None:
        super().__init__(settings)
        profile = self.board.profile
        self.board.profile = replace(profile, can=replace(profile.can, step_px=1))


class MislabelledBackend(VirtualBackend):
    """A bus with a virtual board that names another format than that of its pixels."""

    def __init__(self, settings: VirtualBoardSettings) -> None:
        super().__init__(settings, board=VirtualBoard(settings.scaled(), _mislabelled))


class _Mislabelled(World):
    def code(self, window: Window, size_px: tuple[int, int]) -> int:
        return 0x01100005  # Mono12, as many bytes as BayerRG12


def _mislabelled(pixel_format: int, most_px: int) -> World:
    return _Mislabelled(
        MovingSquare(), pixel_format=pixel_format, noise=0.0, seed=0, most_px=most_px
    )


def configured(**virtual: Any) -> VirtualBoard:
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
