"""Look for dual-stream boards on USB: a bus in, what each board can do out."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from drivers.attached.listing import AttachedSensor, Offer
from drivers.attached.rules import REMEDY
from drivers.usb.block import MOST_BLOCK_BYTES
from drivers.usb.board_settings import known_formats
from drivers.usb.capabilities import BoardCapabilities, CaptureMode
from drivers.usb.link import Attached, Link, attached
from drivers.usb.requests import Request
from pipeline.errors import DriverError, FoveaError
from pipeline.text import harmless

UNNAMED = "a board that does not tell its name"


def look(backend: Any = None) -> Iterator[dict[str, Any]]:
    """Yield every board; one that is in use or may not be opened is told with the reason.

    `backend` is one of pyusb's; None: libusb.
    """
    for board in attached(backend):
        yield asdict(_described(board))


def only_records(serial: str, backend: Any = None) -> bool:
    """Return whether the board of that serial has no live mode; False: that cannot be found out."""
    try:
        found = [board for board in attached(backend) if board.serial == serial]
        return bool(found) and CaptureMode.LIVE not in _capabilities(found[0]).modes
    except FoveaError:  # the check that opens the board tells it
        return False


def _capabilities(board: Attached) -> BoardCapabilities:
    link = Link(board, in_flight=1)
    try:
        return BoardCapabilities.unpack(link.ask(Request.CAPABILITIES, MOST_BLOCK_BYTES))
    finally:
        link.close()


def _described(board: Attached) -> AttachedSensor:
    serial, title = harmless(board.serial, 60), harmless(board.product, 60) or UNNAMED
    name = f"usb:{serial or board.where.removeprefix('usb ')}"
    try:
        can = _capabilities(board)
    except DriverError as error:
        why = str(error)
        remedy = REMEDY if "no permission" in why else ""
        return AttachedSensor(name=name, title=title, where=board.where, problem=why, remedy=remedy)
    firmware = f", firmware {harmless(can.firmware, 30)}" if can.firmware else ""
    chosen = f" --set capture.serial={serial}" if serial else ""
    record = "" if CaptureMode.LIVE in can.modes else " --set capture.mode=record"
    return AttachedSensor(
        name=name,
        title=f"{title}{firmware}",
        where=board.where,
        offers=_offers(can),
        modes=tuple(_mode(mode, can) for mode in can.modes),
        context_px=can.context_px,
        roi_sizes_px=tuple((size.width_px, size.height_px) for size in can.roi_sizes),
        foveates=bool(can.roi_sizes),
        foveation="context and ROI from one exposure" if can.roi_sizes else "it reads no region",
        run=f"fovea run tracking --source usb{chosen}{record}",
    )


def _offers(can: BoardCapabilities) -> tuple[Offer, ...]:
    rates_hz = tuple(rate / 1000 for rate in can.rates_mhz)
    size_px = (can.width_px, can.height_px)
    return tuple(
        Offer(pixel_format=form.name, size_px=size_px, rates_hz=rates_hz, ranged=True)
        for form in known_formats(can)
    )


def _mode(mode: CaptureMode, can: BoardCapabilities) -> str:
    if mode is CaptureMode.LIVE:
        return "live"
    return f"record (bursts of {can.burst_frames} frames, preview at {can.preview_mhz / 1000:g} Hz)"
