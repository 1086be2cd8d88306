"""A plain camera as a dual-stream sensor: whole frames in, context and commanded ROI out.

Foveation is done in software: the full frame crosses the link and is decoded, but only context and
ROI are converted, sent and looked at by the graph.
"""

import threading
import time
import uuid
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from drivers.camera import Camera, Negotiated, Picture, StatesPictures
from drivers.cameras.cutting import Cutter
from drivers.cameras.numbering import ExposureNumbers
from drivers.commands import CommandTable, counts_of
from drivers.readout import exposure_of, geometry_of, scaled
from drivers.sensor import Capabilities, Exposure, Mode
from pipeline.boxes import roi_window
from pipeline.contract import HEADLINE, RATE, Loan
from pipeline.errors import DriverError, PoolExhausted, SettingsError
from pipeline.forecast import Forecast, pictures
from pipeline.import_path import imported
from pipeline.messages import Geometry, Header, RoiSchedule
from pipeline.settings import build

RATES_HZ = (0.1, 1000.0)  # a slower one would look like a stall
POLL_S = 0.1  # how long a stopped `read` may wait for the camera
CLOSE_S = 5.0  # how long `close` waits for a `read` of another thread
SIDE_PX = 32_768  # longest side of a picture


@dataclass(frozen=True, kw_only=True)
class CameraSensorSettings:
    """The camera class with its own settings, and what is cut from its frames."""

    camera: str = ""  # import path of a Camera, e.g. drivers.cameras:Webcam; required
    camera_options: Mapping[str, Any] = field(default_factory=dict)
    context_scale: float = 0.25  # context side per side of the camera's frame
    roi_area: float = 0.0625  # share of the frame that the ROI shows, aspect kept
    roi_scale: float = 1.0  # read-out side per ROI side
    step_px: int = 0  # windows start at multiples of it; 0: 1, or 2 on a mosaic
    rate_hz: float = 0.0  # exposures per second, each the newest frame; 0: every frame
    read_timeout_s: float = 9.0  # longest wait for a frame; a lost camera has its own limit

    def __post_init__(self) -> None:
        for name in ("context_scale", "roi_area", "roi_scale"):
            if not 0 < getattr(self, name) <= 1:
                raise SettingsError(f"{name}: expected above 0 to 1, got {getattr(self, name)}")
        if not 0 <= self.step_px <= SIDE_PX:
            raise SettingsError(f"step_px: expected 0 to {SIDE_PX}, got {self.step_px}")
        if self.rate_hz and not RATES_HZ[0] <= self.rate_hz <= RATES_HZ[1]:
            low, high = RATES_HZ
            raise SettingsError(f"rate_hz: expected {low:g} to {high:g} or 0, got {self.rate_hz}")
        if not 0.1 <= self.read_timeout_s <= 3600:
            raise SettingsError(f"read_timeout_s: expected 0.1 to 3600, got {self.read_timeout_s}")
        self.build_camera()  # so that errors are raised before a process starts

    def build_camera(self) -> Camera:
        """Return the camera, not yet open; raises `SettingsError`."""
        found = imported(self.camera, SettingsError, "camera")
        if not (hasattr(found, "settings_type") and callable(getattr(found, "read", None))):
            raise SettingsError(f"camera: expected a Camera, got {self.camera}")
        built: Camera = found(build(found.settings_type, self.camera_options, "camera_options"))
        return built


class CameraSensor:
    """A `DualStreamSensor` over any `Camera`; the newest frame wins, the others are counted."""

    settings_type: ClassVar[type[Any]] = CameraSensorSettings

    def __init__(self, settings: CameraSensorSettings) -> None:
        self._settings = settings
        self._camera = settings.build_camera()
        self._negotiated: Negotiated | None = None  # while it is open
        self._told: Negotiated | None = None  # the last one
        self._commands: CommandTable | None = None
        self._numbers = ExposureNumbers(0.0, realtime=False)
        self._stopped = threading.Event()
        self._reading = threading.Lock()  # the camera's memory is in use while it is held
        self._windows: Counter[str] = Counter()
        self._exposed = self._overrun = 0
        self._started = self._realtime = False

    @property
    def source(self) -> str:
        """What the pictures come from, for a sentence about it."""
        return str(getattr(self._camera, "source", self._settings.camera))

    @property
    def absent_until_s(self) -> float:
        """Until when the camera is looked for; 0: it is not lost, or does not tell."""
        return float(getattr(self._camera, "absent_until_s", 0.0))

    def open(self, *, realtime: bool) -> None:
        """Open the camera; raises `DriverError`. In lockstep each exposure is the newest frame."""
        self._realtime, self._stream = realtime, uuid.uuid4().hex
        try:
            self._prepare(self._camera.open())
        except BaseException:
            self._camera.close()
            raise

    def capabilities(self) -> Capabilities:
        """What the settings make of the camera; needs `open`."""
        told, grid = self._opened(), self._geometry
        window_px = (grid.roi_width_px, grid.roi_height_px)
        return Capabilities(
            geometry=grid,
            context_px=self._context_px,
            context_binning=grid.width_px / self._context_px[0],
            roi_sizes_px=(window_px,),
            roi_binning=window_px[0] / self._roi_px[0],
            rates_hz=(RATES_HZ[0], told.rate_hz or RATES_HZ[1]),
            pixel_formats=("rgb8",),
            lead_frames=1,
        )

    def forecast(self) -> Forecast:
        """The streams, as far as the camera tells what it delivers."""
        camera, link, told = self._camera, None, self._negotiated
        if isinstance(camera, StatesPictures) and (found := camera.expected()) is not None:
            link, told = found.link, found.negotiated
        if told is None:
            return Forecast(note=f"{self.source} tells its size and rate once it is open")
        cutter = Cutter(told.pixel_format, told.size_px)
        _, context_px, roi_px = self._sizes(told.size_px, cutter.multiple_px)
        known = [rate_hz for rate_hz in (self._settings.rate_hz, told.rate_hz) if rate_hz]
        rate_hz = min(known, default=0.0)
        sides = {"context": context_px, "roi": roi_px}
        return Forecast(
            streams={name: pictures(px, "rgb8", rate_hz) for name, px in sides.items()},
            link=link,
            rate_hz=rate_hz,
            lead_frames=1,
        )

    def configure(self, mode: Mode) -> None:
        """Change the rate; size and format of the ROI follow from the settings."""
        can = self.capabilities()
        if mode.roi_px not in ((0, 0), *can.roi_sizes_px):
            raise SettingsError(f"roi_px: expected one of {can.roi_sizes_px}, got {mode.roi_px}")
        if mode.pixel_format not in ("", *can.pixel_formats):
            raise SettingsError(f"pixel_format: expected rgb8, got {mode.pixel_format}")
        if mode.rate_hz:
            self._settings = replace(self._settings, rate_hz=mode.rate_hz)

    def start(self) -> None:
        """Begin to number exposures; the first is the first frame that is read."""
        self._opened()
        self._numbers = ExposureNumbers(self._settings.rate_hz, realtime=self._realtime)
        self._windows.clear()
        self._exposed = self._overrun = 0
        self._started = True

    def set_rois(self, schedule: RoiSchedule) -> None:
        """Command the windows of coming frames; any thread may call it."""
        if self._commands is None:
            raise DriverError("camera sensor: set_rois needs open before it")
        self._commands.accept(schedule)

    def read(self, loan: Loan) -> Exposure | None:
        """The next exposure; None after `stop`. Raises `DriverError` when the camera is lost."""
        if not self._started:
            raise DriverError("camera sensor: read needs start before it")
        with self._reading:
            asked_ns = time.monotonic_ns()
            if not self._await_due(asked_ns) or (picture := self._next_picture()) is None:
                return None
            header = Header(
                stream=self._stream,
                seq=self._numbers.number(
                    stamp_ns=picture.stamp_ns, skipped=picture.skipped, asked_ns=asked_ns
                ),
                stamp_ns=picture.stamp_ns,
                geometry=self._geometry,
            )
            try:
                exposure = self._expose(header, picture, loan)
            except PoolExhausted:
                self._overrun += 1
                raise
            self._exposed += 1
            return exposure

    def stop(self) -> None:
        """End exposing; a `read` that waits returns None."""
        self._stopped.set()

    def close(self) -> None:
        """Release the camera, after a `read` of another thread has ended."""
        self._stopped.set()
        waited = self._reading.acquire(timeout=CLOSE_S)
        try:
            self._camera.close()
        finally:
            if waited:
                self._reading.release()
        self._negotiated = None

    def summary(self) -> Mapping[str, Any]:
        """Exposures, rate, commands and the camera's own figures.

        `elapsed` is the time in exposures; of the `skipped` ones, `late` were asked for too late.
        """
        numbers = self._numbers
        return {
            **self._rate(),
            **self._headline(),
            "frames": {
                "exposed": self._exposed,
                "skipped": numbers.late + numbers.missing,
                "late": numbers.late,
                "overrun": self._overrun,
                "elapsed": numbers.elapsed,
            },
            "commands": counts_of(self._commands),
            "windows": dict(self._windows),
            "camera": dict(self._camera.summary()),
        }

    def _headline(self) -> dict[str, str]:
        """What was negotiated and what was missed, as a sentence."""
        told, numbers = self._told, self._numbers
        if told is None or not numbers.elapsed:
            return {}
        size = "x".join(str(side) for side in told.size_px)
        missed = numbers.late + numbers.missing + self._overrun
        frames = f"{missed} of {numbers.elapsed} frames missed"
        return {HEADLINE: f"{size} from {self.source} ({told.transport}), {frames}"}

    def _rate(self) -> dict[str, Any]:
        """Without a rate of its own, the one to hold is that of the frames the camera sent."""
        numbers = self._numbers
        asked_hz = self._settings.rate_hz
        if not asked_hz and numbers.spanned_s > 0:
            asked_hz = (numbers.elapsed - 1) / numbers.spanned_s
        if not (numbers.elapsed and asked_hz):
            return {}
        achieved_hz = self._exposed / numbers.elapsed * asked_hz
        return {RATE: {"asked_hz": round(asked_hz, 3), "achieved_hz": round(achieved_hz, 3)}}

    def _opened(self) -> Negotiated:
        if self._negotiated is None:
            raise DriverError("camera sensor: not open")
        return self._negotiated

    def _prepare(self, told: Negotiated) -> None:
        settings = self._settings
        if not all(1 <= side <= SIDE_PX for side in told.size_px):
            got = "x".join(str(side) for side in told.size_px)
            raise DriverError(f"{self.source}: expected sides of 1 to {SIDE_PX} px, got {got}")
        try:
            self._cutter = cutter = Cutter(told.pixel_format, told.size_px)
        except DriverError as error:
            raise DriverError(f"{self.source}: {error}") from error
        if settings.step_px % cutter.multiple_px:
            raise SettingsError(f"step_px: a mosaic needs an even step, got {settings.step_px}")
        grid, self._context_px, self._roi_px = self._sizes(told.size_px, cutter.multiple_px)
        self._geometry = grid
        self._commands = CommandTable(self._stream, grid)
        self._window = _middle(grid)
        self._negotiated = self._told = told
        self._stopped.clear()

    def _sizes(
        self, size_px: tuple[int, int], multiple_px: int
    ) -> tuple[Geometry, tuple[int, int], tuple[int, int]]:
        """Geometry, and sizes of context and ROI as sent, of a picture of this size."""
        settings = self._settings
        grid = geometry_of(
            size_px, roi_area=settings.roi_area, step_px=settings.step_px, multiple_px=multiple_px
        )
        roi_px = scaled((grid.roi_width_px, grid.roi_height_px), settings.roi_scale)
        return grid, scaled(size_px, settings.context_scale), roi_px

    def _await_due(self, now_ns: int) -> bool:
        """Wait until the next exposure is due; False when stopped."""
        wait_s = (self._numbers.due_ns() - now_ns) / 1e9
        return not self._stopped.wait(max(0.0, wait_s))

    def _next_picture(self) -> Picture | None:
        """The camera's newest frame; None when stopped."""
        limit_s = self._settings.read_timeout_s
        deadline_s = time.monotonic() + limit_s
        while not self._stopped.is_set():
            if absent_until_s := self.absent_until_s:
                deadline_s = max(deadline_s, absent_until_s + limit_s)
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise DriverError(f"{self.source}: expected a frame within {limit_s:g} s, got none")
            picture = self._camera.read(min(POLL_S, left_s))
            if picture is not None:
                try:
                    self._cutter.check(picture.pixels)
                except DriverError as error:
                    raise DriverError(f"{self.source}: {error}") from error
                return picture
        return None

    def _expose(self, header: Header, picture: Picture, loan: Loan) -> Exposure:
        width, height = self._context_px
        context = loan("context", (height, width, 3), np.uint8)
        width, height = self._roi_px
        roi = loan("roi", (height, width, 3), np.uint8)
        if self._commands is None:
            raise DriverError("camera sensor: not open")
        aim = self._commands.look_up(header.seq, held=self._window)
        self._window = aim.window
        self._windows[aim.status] += 1
        self._cutter.roi(picture.pixels, aim.window, roi)
        self._cutter.context(picture.pixels, context)
        return exposure_of(header, context, roi, aim, pixel_format="rgb8")


def _middle(grid: Geometry) -> tuple[int, int, int, int]:
    return roi_window(np.array([grid.width_px / 2, grid.height_px / 2], np.float32), grid)
