"""Aravis, the library for GigE Vision and USB3 Vision cameras: loaded when it is first needed.

The only file that imports PyGObject (`gi`), and only when a camera is used. No call waits without
limit: Aravis ends a control transaction after 0.5 s and five repetitions, a search after 1 s, and
buffers are waited for with a timeout.
"""

import contextlib
import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DriverError, InstallError
from pipeline.text import harmless

SYSTEM = "apt-get install gir1.2-aravis-0.8"
BINDING = "libgirepository1.0-dev libcairo2-dev pkg-config gcc && pip install 'fovea[genicam]'"
GONE = (
    "TIMEOUT",
    "NOT_FOUND",
    "NOT_CONNECTED",
    "NOT_CONTROLLER",
    "TRANSFER_ERROR",
)  # of the library's errors


@dataclass(frozen=True, kw_only=True)
class Listed:
    """A device that answered the search."""

    id: str
    vendor: str
    model: str
    serial: str
    protocol: str  # GigEVision | USB3Vision
    address: str  # IP address or USB identifier
    hardware: str  # MAC address or GUID


@cache
def library() -> Any:
    """Aravis and GLib as one namespace; raises `InstallError` with the commands to install them."""
    try:
        import gi
    except ModuleNotFoundError as error:
        raise InstallError(
            f"genicam: expected the package PyGObject, got none: {SYSTEM} {BINDING}"
        ) from error
    try:
        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, GLib
    except (ImportError, ValueError) as error:
        raise InstallError(f"genicam: expected Aravis 0.8, got none: {SYSTEM}") from error
    return SimpleNamespace(aravis=Aravis, error=GLib.Error, native=Native())


def listed(*, search: bool = True) -> tuple[Listed, ...]:
    """Search networks and USB bus, for about a second; else return what was found before."""
    aravis = library().aravis
    if search:
        aravis.update_device_list()
    return tuple(
        Listed(
            id=aravis.get_device_id(i) or "",
            vendor=aravis.get_device_vendor(i) or "",
            model=aravis.get_device_model(i) or "",
            serial=aravis.get_device_serial_nbr(i) or "",
            protocol=aravis.get_device_protocol(i) or "",
            address=aravis.get_device_address(i) or "",
            hardware=aravis.get_device_physical_id(i) or "",
        )
        for i in range(aravis.get_n_devices())
    )


class NoAnswer(DriverError):
    """A camera did not answer in time, or its connection is gone."""


@contextlib.contextmanager
def told(where: str) -> Iterator[None]:
    """Turn an error of the library into a `DriverError` that begins with `where`."""
    try:
        yield
    except library().error as error:
        kind = NoAnswer if _unanswered(error) else DriverError
        raise kind(f"{where}: {harmless(error.message, 200)}") from error


def _unanswered(error: Any) -> bool:
    codes = library().aravis.DeviceError
    gone = {int(getattr(codes, name)) for name in GONE if hasattr(codes, name)}
    return error.domain == "arv-device-error-quark" and error.code in gone


class Native:
    """What the binding cannot do without copying, or not safely: C is asked.

    The hash of a wrapped object is the address of the C object.
    """

    def __init__(self) -> None:
        library = ctypes.CDLL("libaravis-0.8.so.0")
        self._data = library.arv_buffer_get_data
        self._xml = library.arv_device_get_genicam_xml
        for function in (self._data, self._xml):
            function.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
            function.restype = ctypes.c_void_p

    def received(self, buffer: Any) -> NDArray[np.uint8]:
        """A view of the bytes received in a buffer; it keeps the buffer."""
        place, size = self._asked(self._data, buffer)
        if not place or not size:
            return np.zeros(0, np.uint8)
        block = (ctypes.c_uint8 * size).from_address(place)
        block.buffer = buffer  # type: ignore[attr-defined]
        found: NDArray[np.uint8] = np.ctypeslib.as_array(block)
        return found

    def description(self, device: Any) -> bytes:
        """The XML of a device, which no zero byte ends."""
        place, size = self._asked(self._xml, device)
        return ctypes.string_at(place, size) if place else b""

    def _asked(self, function: Any, wrapped: Any) -> tuple[int, int]:
        size = ctypes.c_size_t()
        place = function(hash(wrapped) % (1 << 64), ctypes.byref(size))
        return place or 0, size.value
