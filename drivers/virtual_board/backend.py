"""A virtual board as a backend of pyusb: the driver above it runs as it does on a real bus."""

import ctypes
import errno
import math
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
import usb.backend
import usb.core
from numpy.typing import NDArray

from drivers.noise import Response
from drivers.simulated.sources import open_recording, open_scene, scene_path, shown_by
from drivers.usb.board_forecast import KnownBoard
from drivers.usb.capabilities import BoardCapabilities
from drivers.usb.frame_header import Stream
from drivers.virtual_board.board import OpenWorld, VirtualBoard
from drivers.virtual_board.descriptors import (
    CONFIGURATION,
    DEVICE,
    ENDPOINTS,
    INTERFACE,
    string_descriptor,
)
from drivers.virtual_board.errors import Gone, Halted, Refused, TooMuch
from drivers.virtual_board.faults import faults_of
from drivers.virtual_board.profiles import PROFILES, Profile
from drivers.virtual_board.world import World
from pipeline.errors import DriverError, SettingsError
from pipeline.pixel_formats import BY_CODE

DIRECTION_IN, STANDARD = 0x80, 0x60
GET_DESCRIPTOR, STRING = 6, 3


@dataclass(frozen=True, kw_only=True)
class VirtualBoardSettings:
    """Which board is attached, what it looks at, and what goes wrong."""

    profile: str = "ideal"
    scene: str = ""  # soccer, panorama, or an import path module:Class
    source: str = ""  # import path of a recording
    path: str = ""  # the recording's file or folder
    source_options: Mapping[str, Any] = field(default_factory=dict)
    size_px: tuple[int, int] = (0, 0)  # of the sensor; 0: the profile's
    frames: int = 0  # exposures until the end; 0: all the source has
    noise: float = 0.0  # standard deviation, digital numbers of 8 bit
    # of mosaics: how a pixel counts light, see drivers.noise.Response
    full_well_e: float = 0.0  # photon noise of so many electrons at white; 0: none
    read_noise_e: float = 0.0  # noise of the electronics, electrons
    black_level: int = 0  # digital numbers of the format in the dark
    gamma: float = 1.0  # light is (picture / 255) ^ gamma
    seed: int = 0
    faults: tuple[Mapping[str, Any], ...] = ()  # see drivers.virtual_board.faults.Fault

    def __post_init__(self) -> None:
        if self.profile not in PROFILES:
            raise SettingsError(f"profile: expected {', '.join(PROFILES)}, got {self.profile}")
        if bool(self.scene) == bool(self.source):
            got = f"{self.scene!r} and {self.source!r}"
            raise SettingsError(f"scene or source: expected exactly one of them, got {got}")
        if self.noise and self.full_well_e:
            raise SettingsError(
                f"noise: expected 0 beside full_well_e, which brings its own, got {self.noise}"
            )
        for name in ("frames", "noise", "seed"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise SettingsError(f"{name}: must be at least 0, got {value}")
        self.response(16)
        faults_of(self.faults)
        self.scaled()

    @property
    def shows(self) -> str:
        """The kind of scene before the board, empty where that is not known."""
        return shown_by(self.source or scene_path(self.scene))

    def response(self, bits: int) -> Response:
        """Return how its pixels count light; raises `SettingsError` for what no sensor has."""
        return Response(
            bits=bits, black_level=self.black_level, gamma=self.gamma,
            full_well_e=self.full_well_e, read_noise_e=self.read_noise_e,
        )  # fmt: skip

    def scaled(self) -> Profile:
        """Return the profile with the size of the sensor."""
        profile = PROFILES[self.profile]
        width, height = self.size_px
        if self.size_px in ((0, 0), (profile.can.width_px, profile.can.height_px)):
            return profile
        if width % 16 or height % 16 or not 64 <= min(self.size_px) <= max(self.size_px) <= 65_520:
            raise SettingsError(
                f"size_px: expected multiples of 16 from 64 to 65520, got {width}x{height}"
            )
        return replace(profile, can=_scaled(profile.can, width, height))

    def known_board(self) -> KnownBoard:
        """The board of this profile, for what is planned without opening it."""
        profile = self.scaled()
        return KnownBoard(can=profile.can, readout_frames=profile.readout_frames)


class VirtualBackend(usb.backend.IBackend):  # type: ignore[misc]
    """One board on a bus of its own. Built as `VirtualBackend(settings)`."""

    settings_type = VirtualBoardSettings

    def __init__(
        self, settings: VirtualBoardSettings, *, board: VirtualBoard | None = None
    ) -> None:
        super().__init__()
        self.board = board or VirtualBoard(
            settings.scaled(), _world(settings), faults=faults_of(settings.faults)
        )
        self._lock = threading.Lock()
        self._owner: int | None = None  # who has claimed the interface
        self._opened = 0

    def enumerate_devices(self) -> Iterator[int]:
        if self.board.present:
            yield self.board.plugged_in

    def get_device_descriptor(self, dev: int) -> Any:
        return SimpleNamespace(
            **DEVICE, bus=1, address=dev, port_number=1, port_numbers=(1,), speed=4
        )

    def get_configuration_descriptor(self, dev: int, config: int) -> Any:
        if config:
            raise IndexError(config)
        return SimpleNamespace(**CONFIGURATION, extra_descriptors=b"")

    def get_interface_descriptor(self, dev: int, intf: int, alt: int, config: int) -> Any:
        if intf or alt or config:
            raise IndexError(intf)
        return SimpleNamespace(**INTERFACE, extra_descriptors=b"")

    def get_endpoint_descriptor(self, dev: int, ep: int, intf: int, alt: int, config: int) -> Any:
        return SimpleNamespace(**ENDPOINTS[ep], extra_descriptors=b"", bRefresh=0, bSynchAddress=0)

    def open_device(self, dev: int) -> SimpleNamespace:
        self._check(dev)
        with self._lock:
            self._opened += 1
            return SimpleNamespace(dev=dev, number=self._opened)

    def close_device(self, dev_handle: SimpleNamespace) -> None:
        with self._lock:
            if self._owner == dev_handle.number:
                self._owner = None

    def get_configuration(self, dev_handle: SimpleNamespace) -> int:
        self._check(dev_handle.dev)
        return int(CONFIGURATION["bConfigurationValue"])

    def set_configuration(self, dev_handle: SimpleNamespace, config_value: int) -> None:
        self._check(dev_handle.dev)

    def claim_interface(self, dev_handle: SimpleNamespace, intf: int) -> None:
        self._check(dev_handle.dev)
        with self._lock:
            if self._owner not in (None, dev_handle.number):
                _fail(errno.EBUSY)
            self._owner = dev_handle.number

    def release_interface(self, dev_handle: SimpleNamespace, intf: int) -> None:
        self.close_device(dev_handle)

    def bulk_read(
        self, dev_handle: SimpleNamespace, ep: int, intf: int, buff: Any, timeout: int
    ) -> int:
        self._check(dev_handle.dev)
        stream = Stream([e["bEndpointAddress"] for e in ENDPOINTS].index(ep))
        count = _attempt(lambda: self.board.read(stream, _memory(buff), timeout / 1000))
        if count is None:
            _fail(errno.ETIMEDOUT)
        return int(count)

    def ctrl_transfer(
        self, dev_handle: SimpleNamespace, kind: int, request: int, value: int, index: int,
        data: Any, timeout: int,
    ) -> int:  # fmt: skip
        self._check(dev_handle.dev)
        if not kind & STANDARD and request == GET_DESCRIPTOR and value >> 8 == STRING:
            return _filled(data, _attempt(lambda: string_descriptor(value & 0xFF)))
        if kind & DIRECTION_IN:
            return _filled(data, _attempt(lambda: self.board.ask(request, len(data))))
        _attempt(lambda: self.board.tell(request, value, bytes(data)))
        return len(data)

    def clear_halt(self, dev_handle: SimpleNamespace, ep: int) -> None:
        self._check(dev_handle.dev)
        stream = Stream([e["bEndpointAddress"] for e in ENDPOINTS].index(ep))
        _attempt(lambda: self.board.clear_halt(stream))

    def reset_device(self, dev_handle: SimpleNamespace) -> None:
        self._check(dev_handle.dev)
        _attempt(self.board.reset)

    def is_kernel_driver_active(self, dev_handle: SimpleNamespace, intf: int) -> bool:
        return False

    def _check(self, dev: int) -> None:
        if not self.board.present or dev != self.board.plugged_in:
            _fail(errno.ENODEV)


def _attempt(act: Any) -> Any:
    try:
        return act()
    except Gone:
        _fail(errno.ENODEV)
    except (Halted, Refused):
        _fail(errno.EPIPE)
    except TooMuch:
        _fail(errno.EOVERFLOW)


def _fail(number: int) -> NoReturn:
    kind = usb.core.USBTimeoutError if number == errno.ETIMEDOUT else usb.core.USBError
    raise kind(errno.errorcode[number], None, number)


def _memory(buff: Any) -> NDArray[np.uint8]:
    """The memory behind what pyusb takes for an array."""
    address, length = buff.buffer_info()
    held = (ctypes.c_uint8 * (length * buff.itemsize)).from_address(address)
    return np.frombuffer(held, np.uint8)


def _filled(buff: Any, data: bytes) -> int:
    count = min(len(buff), len(data))
    buff[:count] = type(buff)("B", data[:count])
    return int(count)


def _world(settings: VirtualBoardSettings) -> OpenWorld:
    size_px = settings.size_px
    if size_px == (0, 0):
        can = settings.scaled().can
        size_px = (can.width_px, can.height_px)

    def opened(pixel_format: int, most_px: int) -> World:
        form = BY_CODE[pixel_format]
        response = settings.response(form.bits)
        if not form.order and response != Response(bits=form.bits):
            raise DriverError(
                f"virtual board: expected a mosaic with full_well_e, black_level or gamma, "
                f"got {form.name}"
            )
        if settings.source:
            source = open_recording(
                settings.source, path=settings.path, options=settings.source_options
            )
        else:
            source = open_scene(
                settings.scene, size_px=size_px, rate_hz=0.0, seed=settings.seed,
                length=settings.frames or None, options=settings.source_options,
            )  # fmt: skip
        if source.size_px != size_px:
            source.close()
            expected, got = ("x".join(map(str, size)) for size in (size_px, source.size_px))
            raise DriverError(f"virtual board: expected a source of {expected}, got {got}")
        return World(
            source, pixel_format=pixel_format, noise=settings.noise, seed=settings.seed,
            response=response, most_px=most_px,
        )  # fmt: skip

    return opened


def _scaled(can: BoardCapabilities, width: int, height: int) -> BoardCapabilities:
    """Return the capabilities of a sensor of another size and the same kind."""

    def side(value: int, share: float) -> int:
        return max(4, round(value * share / 4) * 4)

    across, down = width / can.width_px, height / can.height_px
    return replace(
        can, width_px=width, height_px=height,
        context_px=(side(can.context_px[0], across), side(can.context_px[1], down)),
        roi_sizes=tuple(
            replace(s, width_px=side(s.width_px, across), height_px=side(s.height_px, down))
            for s in can.roi_sizes
        ),
    )  # fmt: skip
