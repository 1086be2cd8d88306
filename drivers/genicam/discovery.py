"""Cameras on networks and USB bus: nothing in, what is attached and what it can do out."""

import contextlib
from dataclasses import dataclass, field, replace

from drivers.genicam.aravis import Listed, NoAnswer, listed
from drivers.genicam.device import Device
from drivers.genicam.formats import offered
from drivers.genicam.foveation import Foveation, foveation
from pipeline.errors import DriverError, FoveaError
from pipeline.text import harmless


@dataclass(frozen=True, kw_only=True)
class AttachedCamera:
    """One camera, as it describes itself."""

    id: str  # what the setting `camera` takes
    vendor: str
    model: str
    serial: str
    protocol: str  # GigEVision | USB3Vision
    address: str
    field_px: tuple[int, int] = (0, 0)  # width, height; 0: not told
    pixel_formats: tuple[str, ...] = ()  # PFNC names that can be read
    rates_hz: tuple[float, float] = (0.0, 0.0)  # lowest and highest; 0: not told
    foveation: Foveation = field(default_factory=Foveation)
    problem: str = ""  # why it could not be asked, in one sentence


def discover(*, ask: bool = True) -> tuple[AttachedCamera, ...]:
    """Search for a second; with `ask` every camera is opened and asked what it can do.

    Raises `InstallError` without Aravis. A camera in use is listed with the problem.
    """
    return tuple(_asked(found) if ask else _plain(found) for found in listed())


def opened(camera: str, *, before: str = "") -> Device:
    """Open the camera that the setting names; raises `DriverError` naming what is attached.

    The setting is an id, a serial number or an address. What is not listed, such as a user name or
    an address of another network, is left to the library. Empty: the only one attached. `before`
    is the id of a camera that was listed and lost: it is opened once it is listed again.
    """
    known = _matching(camera, listed(search=False)) if camera and not before else None
    if known is not None:
        with contextlib.suppress(NoAnswer):  # it may have moved: search for it
            return Device(known, listed=True)
    found = listed()
    if known := _matching(before or camera, found) if before or camera else None:
        return Device(known, listed=True)
    if before:
        raise DriverError(f"camera {before}: expected it attached, got {_names(found)}")
    if camera:
        try:
            return Device(camera)
        except DriverError as error:
            raise DriverError(f"{error}; attached: {_names(found)}") from error
    if len(found) == 1:
        return Device(found[0].id, listed=True)
    raise DriverError(f"camera: expected one attached, or the name of one, got {_names(found)}")


def _matching(camera: str, found: tuple[Listed, ...]) -> str | None:
    matching = {
        one.id for one in found if camera in (one.id, one.serial, one.address, one.hardware)
    }
    if len(matching) > 1:
        raise DriverError(f"camera: {harmless(camera, 60)} names several of {_names(found)}")
    return next(iter(matching), None)


def _names(found: tuple[Listed, ...]) -> str:
    return ", ".join(harmless(f"{one.id} ({one.address})", 80) for one in found[:20]) or "none"


def _plain(found: Listed) -> AttachedCamera:
    return AttachedCamera(
        id=harmless(found.id, 120),
        vendor=harmless(found.vendor, 60),
        model=harmless(found.model, 60),
        serial=harmless(found.serial, 60),
        protocol=found.protocol,
        address=harmless(found.address, 60),
    )


def _asked(found: Listed) -> AttachedCamera:
    plain = _plain(found)
    try:
        device = Device(found.id, listed=True)
    except FoveaError as error:
        return replace(plain, problem=str(error))
    try:
        width, height = (device.known(f"Sensor{side}") or 0 for side in ("Width", "Height"))
        return replace(
            plain,
            field_px=(int(width), int(height)),
            pixel_formats=offered(device.nodes),
            rates_hz=device.rates(),
            foveation=foveation(device.nodes, device.known),
        )
    finally:
        device.close()
