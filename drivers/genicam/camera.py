"""An industrial camera with one stream: settings in, its newest whole frame out."""

import contextlib
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from drivers.camera import Expected, Negotiated, Picture
from drivers.genicam.clock import CameraClock
from drivers.genicam.connection import Connection
from drivers.genicam.device import Device, FeatureValue
from drivers.genicam.discovery import opened
from drivers.genicam.formats import (
    BY_CODE,
    BY_NAME,
    CameraFormat,
    entry_of,
    offered,
    unpack,
    view,
)
from drivers.genicam.intake import Intake, Shape
from drivers.genicam.stream import COUNTED, Arrived
from pipeline.errors import DriverError, SettingsError
from pipeline.forecast import LinkUse

SLICE_S = 0.05  # a `read` that waits notices `close` this soon
WRAP = 0xFFFF  # frame numbers of GigE Vision 1 go from here to 1


@dataclass(frozen=True, kw_only=True)
class GenicamCameraSettings:
    """Zeros and empty texts keep what the camera has."""

    camera: str = ""  # id, serial, user name or address; empty: the only one attached
    features: Mapping[str, FeatureValue] = field(default_factory=dict)  # by SFNC name
    size_px: tuple[int, int] = (0, 0)  # of the window read, in the middle of the field
    binning: int = 0
    pixel_format: str = ""  # PFNC name, e.g. BayerRG8; empty: the camera's, or the best it has
    rate_hz: float = 0.0
    buffers: int = 8  # in flight
    chunks: bool = True  # ask for the time stamp as a chunk where the camera has chunks
    packet_bytes: int = 0  # GigE Vision; 0: the largest that arrives
    absent_s: float = 6.0  # a lost camera that stays away longer is an error

    def __post_init__(self) -> None:
        if self.size_px != (0, 0) and not all(1 <= side <= 65_535 for side in self.size_px):
            raise SettingsError(f"size_px: expected sides of 1 to 65535, got {self.size_px}")
        if not 0 <= self.binning <= 32:
            raise SettingsError(f"binning: expected 0 to 32, got {self.binning}")
        if self.pixel_format and self.pixel_format not in BY_NAME:
            known = ", ".join(BY_NAME)
            raise SettingsError(f"pixel_format: expected one of {known}, got {self.pixel_format}")
        if not (math.isfinite(self.rate_hz) and 0 <= self.rate_hz <= 10_000):
            raise SettingsError(f"rate_hz: expected 0 to 10000, got {self.rate_hz}")
        if not 2 <= self.buffers <= 256:
            raise SettingsError(f"buffers: expected 2 to 256, got {self.buffers}")
        if self.packet_bytes and not 576 <= self.packet_bytes <= 16_000:
            raise SettingsError(f"packet_bytes: expected 576 to 16000, got {self.packet_bytes}")
        if not 0 < self.absent_s <= 86_400:
            raise SettingsError(f"absent_s: expected above 0 to 86400, got {self.absent_s}")


class _Running:
    """An open camera that exposes, its clock, and the thread that takes its frames."""

    def __init__(
        self,
        device: Device,
        settings: GenicamCameraSettings,
        counts: Counter[str],
        lost: Callable[[str], None],
    ) -> None:
        self._counts = counts
        self.device, self.clock, self.last_id = device, CameraClock(), -1
        form = configure(device, settings)
        parser = device.enable_chunks() if settings.chunks else None
        size_px = device.integer("Width"), device.integer("Height")
        if size_px[0] % form.multiple_px:
            raise DriverError(
                f"{device.key}: Width: expected a multiple of {form.multiple_px} for {form.name}, "
                f"got {size_px[0]}: set size_px, or another pixel_format"
            )
        self.shape = Shape(size_px=size_px, form=form)
        self.samples = np.empty(size_px[::-1], np.uint16) if form.packs else None
        self.stream = device.stream(settings.buffers, parser, settings.packet_bytes)
        device.acquire(True)
        self.intake = Intake(device, self.stream, self.shape, faults=counts, lost=lost)

    def close(self) -> None:
        """End exposing and release the device."""
        self.intake.close()
        with contextlib.suppress(DriverError):  # it may be lost in this moment
            if not self.device.lost.is_set():
                self.device.acquire(False)
        self._counts.update(self.stream.figures())
        self.stream.close()
        self.device.close()


class GenicamCamera:
    """A `Camera` over GigE Vision or USB3 Vision, with several buffers in flight.

    Frames that are incomplete, of another size or of another format are counted, never delivered.
    A lost camera is opened again with the same settings.
    """

    settings_type: ClassVar[type[Any]] = GenicamCameraSettings

    def __init__(self, settings: GenicamCameraSettings) -> None:
        self._settings = settings
        self._connection: Connection[_Running] | None = None
        self._reading = threading.Lock()
        self._closed = threading.Event()
        self._hand: tuple[Intake, Arrived] | None = None  # what the last `read` returned
        self._counts: Counter[str] = Counter()
        self._stamps = "arrival"
        self._id = ""  # of the camera once it was listed
        self._told: Negotiated | None = None  # since the first `open`
        self._form: CameraFormat | None = None
        self._link = ""

    @property
    def source(self) -> str:
        """What the pictures come from, for a sentence about it."""
        return f"camera {self._settings.camera}".strip()

    @property
    def absent_until_s(self) -> float:
        """Until when it looks for a lost camera, in `time.monotonic()`; 0: none is lost."""
        return self._connection.absent_until_s if self._connection else 0.0

    def open(self) -> Negotiated:
        """Open and start; raises `DriverError`, or `InstallError` without Aravis."""
        self._closed.clear()
        self._id = ""
        connection = Connection(self.source, self._start, absent_s=self._settings.absent_s)
        self._connection = connection
        running = connection.open()
        self._form, self._link = running.shape.form, running.device.link
        self._told = Negotiated(
            size_px=running.shape.size_px,
            rate_hz=running.device.rate(),
            pixel_format=running.shape.form.unpacked.name,
            transport=running.device.protocol + f" Vision, {running.shape.form.name}",
        )
        return self._told

    def expected(self) -> Expected | None:
        """What was negotiated; before it was open what is asked of it, if that is everything."""
        wanted, told, form = self._settings, self._told, self._form
        if told is None or form is None:
            if wanted.size_px == (0, 0) or not wanted.pixel_format:
                return None
            form = BY_NAME[wanted.pixel_format]
            told = Negotiated(
                size_px=wanted.size_px,
                rate_hz=wanted.rate_hz,
                pixel_format=form.unpacked.name,
                transport=form.name,
            )
        crossing = form.crossing(told.size_px, told.rate_hz)
        return Expected(negotiated=told, link=LinkUse(streams=(crossing,), kind=self._link))

    def read(self, timeout_s: float) -> Picture | None:
        """The newest frame, valid until the next call: a view of its buffer, or unpacked."""
        deadline_s = time.monotonic() + timeout_s
        with self._reading:
            self._return_hand()
            while not self._closed.is_set() and self._connection is not None:
                left_s = min(max(deadline_s - time.monotonic(), 0), SLICE_S)
                running = self._connection.held(left_s)
                arrived = running.intake.take(left_s) if running is not None else None
                if running is not None and arrived is not None:
                    return self._delivered(running, arrived)
                if time.monotonic() >= deadline_s:
                    break
        return None

    def close(self) -> None:
        """Release the camera; a waiting `read` returns None within `SLICE_S`."""
        self._closed.set()
        with self._reading:
            connection, self._connection = self._connection, None
            self._hand = None
            if connection is not None:
                self._counts["losses"] += connection.losses
                connection.close()

    def summary(self) -> Mapping[str, Any]:
        """Frames by what became of them, losses, the origin of the stamps; packets once it ends."""
        connection = self._connection
        names = ("delivered", "skipped", "incomplete", "unfitting")
        return {
            "frames": {name: self._counts[name] for name in names},
            "losses": self._counts["losses"] + (connection.losses if connection else 0),
            "stamps": self._stamps,
            "packets": {name: self._counts[name] for name in COUNTED.values()},
        }

    def _start(self) -> _Running:
        device = opened(self._settings.camera, before=self._id)
        self._id = device.id
        try:
            return _Running(device, self._settings, self._counts, self._lose)
        except BaseException:
            device.close()
            raise

    def _lose(self, why: str) -> None:
        if self._connection is not None:
            self._connection.lose(why)

    def _delivered(self, running: _Running, arrived: Arrived) -> Picture:
        pixels = view(arrived, running.shape.form)
        if pixels is None:
            raise DriverError(f"{running.device.key}: expected a whole picture, got a part")
        stamp_ns = arrived.chunks.get("Timestamp", arrived.stamp_ns)
        skipped = gap(running.last_id, arrived.frame_id)
        running.last_id, self._hand = arrived.frame_id, (running.intake, arrived)
        self._counts.update(delivered=1, skipped=skipped)
        stamp_ns = running.clock.monotonic_ns(stamp_ns, arrived.arrived_ns)
        self._stamps = "camera" if running.clock.trusted else "arrival"
        if running.samples is not None:
            unpack(pixels, running.shape.form, running.samples)
            pixels = running.samples
        return Picture(pixels=pixels, stamp_ns=stamp_ns, skipped=skipped)

    def _return_hand(self) -> None:
        hand, self._hand = self._hand, None
        if hand is not None:
            hand[0].drop(hand[1])


def configure(device: Device, settings: GenicamCameraSettings) -> CameraFormat:
    """Write the settings to the camera: features in their order, then format, size and rate."""
    for name, value in settings.features.items():
        device.write(name, value)
    form = set_format(device, settings.pixel_format)
    if settings.binning:
        for axis in ("Horizontal", "Vertical"):
            device.write(f"Binning{axis}", settings.binning)
    if settings.size_px != (0, 0):
        _set_window(device, settings.size_px)
    if settings.rate_hz:
        device.set_rate(settings.rate_hz)
    return form


def set_format(device: Device, wanted: str) -> CameraFormat:
    """Set a PFNC format; without a wish the camera's own stays if it can be read."""
    nodes = device.nodes
    present = BY_CODE.get(int(device.known("PixelFormat") or 0) & 0xFFFFFFFF)
    if not wanted and present is not None:
        return present
    known = offered(nodes)
    last = None
    for name in (wanted,) if wanted else known:
        try:
            device.write("PixelFormat", entry_of(nodes, name) or name)
        except DriverError as error:  # stated, but not of this sensor
            last = error
            continue
        return BY_NAME[name]
    if last is not None:
        raise last
    raise DriverError(f"{device.key}: PixelFormat: expected one of {', '.join(BY_NAME)}, got none")


def gap(last_id: int, frame_id: int) -> int:
    """Frames between two frame numbers; 0 where numbers begin anew.

    >>> gap(-1, 7), gap(7, 8), gap(7, 10), gap(65535, 1), gap(65534, 2), gap(900, 3)
    (0, 0, 2, 0, 2, 0)
    """
    if last_id < 0:
        return 0
    if frame_id > last_id:
        return frame_id - last_id - 1
    wrapped = frame_id + WRAP - last_id - 1
    return wrapped if last_id <= WRAP and wrapped < WRAP // 2 else 0


def _set_window(device: Device, size_px: tuple[int, int]) -> None:
    for offset, side, length in zip(
        ("OffsetX", "OffsetY"), ("Width", "Height"), size_px, strict=True
    ):
        if device.has(offset):
            device.write(offset, 0)
        device.write(side, length)
        most = device.known(f"{side}Max") or device.known(f"Sensor{side}")
        if device.has(offset) and most is not None:
            step = int(device.step(offset))
            device.write(offset, max(int(most) - length, 0) // 2 // step * step)
