"""An industrial camera that foveates: ROI schedules in, its full field and one window out.

Context and ROI are **two successive exposures** of one camera: it is aimed at its full field
(binned) and triggered, then at the window and triggered again. `Capabilities.same_exposure` is
False, and the ROI's `Frame.delay_ns` is the time from the context to it.
"""

import threading
import uuid
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.commands import CommandTable
from drivers.genicam.alternation import Aim, Alternation
from drivers.genicam.aravis import NoAnswer
from drivers.genicam.camera import configure
from drivers.genicam.connection import Connection
from drivers.genicam.discovery import opened
from drivers.genicam.formats import BY_NAME, CameraFormat, copy_frame, offered, view
from drivers.genicam.foveation import foveation, plain_hint
from drivers.genicam.rig import Layout, Lost, Rig, layout, shown
from drivers.genicam.sensor_settings import GenicamSensorSettings
from drivers.genicam.stream import Arrived
from drivers.sensor import Capabilities, Exposure, Mode
from pipeline.boxes import roi_window
from pipeline.contract import RATE, Loan
from pipeline.errors import DriverError, PoolExhausted, SettingsError
from pipeline.forecast import Forecast, LinkUse, pictures
from pipeline.messages import Frame, Geometry, Header, RoiSchedule

WAIT_S = 0.1  # how soon a waiting `read` notices `stop`
SLOWEST_HZ, FASTEST_HZ = 0.01, 1000.0  # of exposures, where the camera does not tell


class GenicamSensor:
    """A `DualStreamSensor` over one camera that can be aimed while it streams.

    A camera that cannot is refused by `open`, with the reason and the options to run it as a plain
    one. The window of a frame is the one that the camera states in it, never the commanded one.
    """

    settings_type: ClassVar[type[Any]] = GenicamSensorSettings

    def __init__(self, settings: GenicamSensorSettings) -> None:
        self._settings = settings
        self._connection: Connection[Rig[Aim]] | None = None
        self._commands: CommandTable | None = None
        self._can: Capabilities | None = None
        self._stopped = threading.Event()
        self._reading = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._windows: Counter[str] = Counter()
        self._turns: Alternation | None = None
        self._latency = 0

    @property
    def source(self) -> str:
        """What the pictures come from, for a sentence about it."""
        return f"camera {self._settings.camera}".strip()

    @property
    def absent_until_s(self) -> float:
        """Until when it looks for a lost camera, in `time.monotonic()`; 0: none is lost."""
        return self._connection.absent_until_s if self._connection else 0.0

    def open(self, *, realtime: bool) -> None:
        """Open, judge and try the camera; raises `DriverError` for one that cannot foveate."""
        self._realtime, self._stream_id = realtime, uuid.uuid4().hex
        self._stopped.clear()
        self._prepare()

    def capabilities(self) -> Capabilities:
        """What the camera can do; needs `open`."""
        if self._can is None:
            raise DriverError(f"{self.source}: not open")
        return self._can

    def forecast(self) -> Forecast:
        """Both streams of an open camera: its sizes follow from its own field and steps."""
        connection, can, rate_hz = self._connection, self._can, self._settings.rate_hz
        rig = connection.held(0.0) if connection is not None else None
        if rig is None or can is None:
            note = f"{self.source} tells its field once it is open"
            return Forecast(note=note, rate_hz=rate_hz)
        stream = pictures(can.context_px, rig.form.ours, rate_hz)
        crossing = rig.form.crossing(can.context_px, rate_hz)
        return Forecast(
            streams={"context": stream, "roi": stream},
            note="" if rate_hz else "rate_hz 0 is as fast as the camera answers",
            link=LinkUse(streams=(crossing, crossing), kind=rig.device.link),
            rate_hz=rate_hz,
            lead_frames=can.lead_frames,
        )

    def configure(self, mode: Mode) -> None:
        """Change rate, window size or pixel format; the camera is opened again for it."""
        can, changes = self.capabilities(), dict[str, Any]()
        if mode.rate_hz:
            low, high = can.rates_hz
            if not low <= mode.rate_hz <= high:
                raise SettingsError(f"rate_hz: expected {low:g} to {high:g}, got {mode.rate_hz}")
            changes["rate_hz"] = mode.rate_hz
        if mode.roi_px != (0, 0):
            if mode.roi_px not in can.roi_sizes_px:
                raise SettingsError(
                    f"roi_px: expected one of {can.roi_sizes_px}, got {mode.roi_px}"
                )
            changes["binning"] = self._factor_of[mode.roi_px]
        if mode.pixel_format not in ("", *can.pixel_formats):
            known = ", ".join(can.pixel_formats)
            raise SettingsError(f"pixel_format: expected {known}, got {mode.pixel_format}")
        if mode.pixel_format:
            names = {BY_NAME[name].ours: name for name in reversed(self._offered)}
            changes["pixel_format"] = names[mode.pixel_format]
        self._settings = replace(self._settings, **changes)
        self._release()
        self._prepare()

    def start(self) -> None:
        """Begin to expose with the next `read`."""
        grid, commands = self.capabilities().geometry, self._commands
        if commands is None:
            raise DriverError(f"{self.source}: start needs open before it")
        middle = np.array([grid.width_px / 2, grid.height_px / 2], np.float32)
        rate_hz = self._settings.rate_hz if self._realtime else 0.0
        self._turns = Alternation(commands, roi_window(middle, grid), rate_hz, self._stopped)

    def set_rois(self, schedule: RoiSchedule) -> None:
        """Command the windows of coming frames; any thread may call it."""
        if self._commands is None:
            raise DriverError(f"{self.source}: set_rois needs open before it")
        self._commands.accept(schedule)

    def read(self, loan: Loan) -> Exposure | None:
        """The next exposure; None after `stop`. A lost camera is opened again meanwhile."""
        turns = self._turns
        if turns is None:
            raise DriverError(f"{self.source}: read needs start before it")
        context: Frame | None = None
        with self._reading:
            while not self._stopped.is_set():
                taken = self._taken(turns)
                if taken is None:  # no camera, or none of its frames
                    context = None
                    continue
                rig, arrived, aim = taken
                try:
                    frame = self._frame(rig, arrived, aim, context, loan)
                finally:
                    rig.drop(arrived)
                if aim.roi is None or frame is None:
                    context = frame
                elif context is not None:
                    return self._exposed(context, frame)
        return None

    def stop(self) -> None:
        """End exposing; a `read` that waits returns None."""
        self._stopped.set()

    def close(self) -> None:
        """Release the camera; safe after any outcome."""
        self._stopped.set()
        with self._reading:
            self._release()
            self._turns = None

    def summary(self) -> Mapping[str, Any]:
        """Exposures, frames by what became of them, commands, the measured latency, losses."""
        commands, counts = self._commands, self._counts
        found: dict[str, Any] = {
            "frames": {
                **{name: counts[name] for name in ("exposed", "overrun", "astray", "incomplete")},
                "late": self._turns.late if self._turns else 0,
            },
            "windows": dict(self._windows),
            "commands": {
                "accepted": commands.accepted if commands else 0,
                "late": commands.late if commands else 0,
                "foreign": commands.foreign if commands else 0,
            },
            "latency_frames": self._latency,
            "losses": counts["losses"] + (self._connection.losses if self._connection else 0),
        }
        if counts["exposed"] > 1:
            lasted_s = (counts["last_ns"] - counts["first_ns"]) / 1e9
            achieved_hz = (counts["exposed"] - 1) / max(lasted_s, 1e-9)
            asked_hz = self._settings.rate_hz or achieved_hz
            found[RATE] = {"asked_hz": round(asked_hz, 3), "achieved_hz": round(achieved_hz, 3)}
        return found

    def _prepare(self) -> None:
        """Open the camera and learn from it what `capabilities` says."""
        self._can = None  # not open, should this fail
        self._layout: Layout | None = None
        self._id = ""  # of the camera once it was listed
        connection = Connection(self.source, self._made, absent_s=self._settings.absent_s)
        self._connection = connection
        try:
            rig = connection.open()
        except BaseException:
            self._connection = None
            raise
        self._layout, self._latency = rig.plan, rig.latency
        self._can = self._described(rig)
        lead = self._can.lead_frames
        self._commands = CommandTable(self._stream_id, self._can.geometry, latency_frames=lead - 1)

    def _made(self) -> Rig[Aim]:
        """Open and try the camera; raises `DriverError` for one that cannot foveate."""
        settings = self._settings
        device = opened(settings.camera, before=self._id)
        self._id = device.id
        try:
            verdict = foveation(device.nodes, device.known)
            if not verdict.means:
                hint = plain_hint(settings.camera)
                raise DriverError(f"{device.key}: cannot foveate: {verdict.reason}; {hint}")
            form = configure(device, replace(settings.camera_settings(), binning=0))
            mosaic = form.ours.startswith("bayer")
            wide = form.multiple_px
            plan = layout(device.key, verdict, settings.binning, mosaic=mosaic, multiple_px=wide)
        except BaseException:
            device.close()
            raise
        if self._layout not in (None, plan):
            device.close()
            raise DriverError(f"{device.key}: expected {self._layout} as before, got {plan}")
        limits = {"buffers": settings.buffers, "packet_bytes": settings.packet_bytes}
        return Rig(device, verdict, form, plan, answer_s=settings.answer_s, **limits)

    def _described(self, rig: Rig[Aim]) -> Capabilities:
        plan, verdict = rig.plan, rig.verdict
        self._offered = offered(rig.device.nodes)
        sizes = verdict.roi_sizes_px()
        self._factor_of = dict(zip(sizes, verdict.factors, strict=False))
        (width, height), (roi_width, roi_height) = plan.field_px, plan.size_px
        fastest_hz = verdict.rates_hz[1] / 2 or FASTEST_HZ
        return Capabilities(
            geometry=Geometry(
                width_px=width,
                height_px=height,
                roi_width_px=roi_width,
                roi_height_px=roi_height,
                step_px=rig.step_px,
            ),
            context_px=plan.size_px,
            context_binning=float(plan.factor),
            roi_sizes_px=sizes,
            roi_binning=1.0,
            rates_hz=(SLOWEST_HZ, fastest_hz),
            pixel_formats=tuple(dict.fromkeys(BY_NAME[name].ours for name in self._offered)),
            lead_frames=1 + rig.latency // 2,
            same_exposure=False,
        )

    def _taken(self, turns: Alternation) -> tuple[Rig[Aim], Arrived, Aim] | None:
        """Take the next aimed frame; None: none, as the camera is away or has latency."""
        connection = self._connection
        rig = connection.held(WAIT_S) if connection is not None else None
        if rig is None or connection is None:
            return None
        aim = turns.next()
        if aim is None:
            return None
        before = rig.incomplete
        try:
            found = rig.next(None if aim.roi is None else aim.roi.window[:2], aim)
        except DriverError as error:
            if not isinstance(error, (Lost, NoAnswer)):
                raise
            rig.device.lost.set()
            connection.lose(str(error))
            turns.restart()
            return None
        finally:
            self._counts["incomplete"] += rig.incomplete - before
        return None if found is None else (rig, *found)

    def _frame(
        self, rig: Rig[Aim], arrived: Arrived, aim: Aim, context: Frame | None, loan: Loan
    ) -> Frame | None:
        """The frame as the camera states it; None for one that shows no place of its exposure."""
        grid, pixels, offset = self.capabilities().geometry, view(arrived, rig.form), shown(arrived)
        if aim.roi is None:
            if pixels is None or offset != (0, 0):
                self._counts["astray"] += 1
                return None
            stamp_ns, stream = rig.stamp_ns(arrived), self._stream_id
            return Frame(
                header=Header(stream=stream, seq=aim.seq, stamp_ns=stamp_ns, geometry=grid),
                pixels=self._copied(loan, "context", pixels, rig.form),
                pixel_format=rig.form.ours,
                window=(0, 0, grid.width_px, grid.height_px),
            )
        if pixels is None or context is None or context.header.seq != aim.seq:
            return None  # its context was lost
        window = (*offset, offset[0] + grid.roi_width_px, offset[1] + grid.roi_height_px)
        obeyed = window == aim.roi.window
        return Frame(
            header=context.header,
            pixels=self._copied(loan, "roi", pixels, rig.form),
            pixel_format=rig.form.ours,
            window=window,
            command_seq=aim.roi.command_seq if obeyed else -1,
            status=aim.roi.status if obeyed else "stale",
            delay_ns=max(rig.stamp_ns(arrived) - context.header.stamp_ns, 0),
        )

    def _copied(
        self, loan: Loan, output: str, pixels: NDArray[Any], form: CameraFormat
    ) -> NDArray[Any]:
        size_px = self.capabilities().context_px  # the ROI has as many pixels
        try:
            memory = loan(output, form.form.shape(size_px), form.form.dtype)
        except PoolExhausted:
            self._counts["overrun"] += 1
            raise
        copy_frame(pixels, form, memory)
        return memory

    def _exposed(self, context: Frame, roi: Frame) -> Exposure:
        self._windows[roi.status] += 1
        counts = self._counts
        counts["exposed"] += 1
        counts["first_ns"] = counts["first_ns"] or context.header.stamp_ns
        counts["last_ns"] = context.header.stamp_ns
        return Exposure(header=context.header, context=context, roi=roi)

    def _release(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            self._counts["losses"] += connection.losses
            connection.close()
