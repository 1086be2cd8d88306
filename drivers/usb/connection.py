"""A connection to one board: finds and opens it, and asks in terms of the protocol."""

from collections.abc import Callable
from typing import Any

from drivers.usb.block import MOST_BLOCK_BYTES
from drivers.usb.capabilities import BoardCapabilities
from drivers.usb.errors import Stalled
from drivers.usb.link import Attached, Link, attached
from drivers.usb.requests import (
    Acknowledgement,
    BoardStatus,
    BoardTime,
    Configuration,
    Request,
    Schedule,
)
from pipeline.errors import DriverError

START_S = 10.0  # for a sensor to begin
TRIGGERED = 1  # flag of START: an exposure happens when TRIGGER asks for it
Backend = Callable[[], Any]  # makes a backend of pyusb; None: pyusb's own


class Connection:
    """An opened board; every method raises `LinkError` when the link fails."""

    def __init__(self, backend: Any, *, serial: str, in_flight: int) -> None:
        board = _chosen(attached(backend), serial)
        self.link = Link(board, in_flight=in_flight)
        try:
            self.can = BoardCapabilities.unpack(self._ask(Request.CAPABILITIES))
        except BaseException:
            self.link.close()
            raise
        self.serial = board.serial

    @property
    def where(self) -> str:
        """Bus and address, for sentences about it."""
        return self.link.where

    def configure(self, wanted: Configuration) -> Configuration:
        """Configure the board; return what is in effect. Raises `Stalled` where it refuses."""
        self.link.tell(Request.CONFIGURE, wanted.pack())
        effective = Configuration.unpack(self._ask(Request.CONFIGURATION))
        for field in ("roi_px", "pixel_format", "mode"):
            expected, got = getattr(wanted, field), getattr(effective, field)
            if expected != got:  # some boards cannot stall a request whose data have come
                raise Stalled(f"{self.where}: {field}: expected {expected}, the board has {got}")
        return effective

    def start(self, *, triggered: bool) -> None:
        """Begin to expose; exposures count from 0 again."""
        value = TRIGGERED if triggered else 0
        self.link.tell(Request.START, value=value, timeout_s=START_S)

    def trigger(self) -> None:
        """Expose one frame, where START asked for that."""
        self.link.tell(Request.TRIGGER)

    def stop(self) -> None:
        """End exposing."""
        self.link.tell(Request.STOP)

    def schedule(self, schedule: Schedule) -> Acknowledgement:
        """Send a schedule; return what becomes of it."""
        self.link.tell(Request.SCHEDULE, schedule.pack())
        return Acknowledgement.unpack(self._ask(Request.ACKNOWLEDGEMENT))

    def time_ns(self) -> int:
        """The board's clock."""
        return BoardTime.unpack(self._ask(Request.TIME)).now_ns

    def status(self) -> BoardStatus:
        """What the board says about itself."""
        return BoardStatus.unpack(self._ask(Request.STATUS))

    def close(self) -> None:
        """Release the device."""
        self.link.close()

    def _ask(self, request: Request) -> bytes:
        return self.link.ask(request, MOST_BLOCK_BYTES)


def _chosen(boards: list[Attached], serial: str) -> Attached:
    """Return the board of that serial number, or the only one; raises `DriverError`."""
    fitting = [board for board in boards if serial in ("", board.serial)]
    if len(fitting) == 1:
        return fitting[0]
    found = ", ".join(board.serial or f"{board.where} (no permission)" for board in boards)
    if not boards:
        raise DriverError("usb: no board is attached; `fovea doctor` looks at the bus")
    if not fitting:
        raise DriverError(f"serial: no board {serial}; attached: {found}")
    raise DriverError(f"serial: expected one of the boards that are attached, {found}")
