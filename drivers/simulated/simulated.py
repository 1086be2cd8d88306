"""The simulated dual-stream sensor: Eq. 1 over any full-resolution source.

The full frame leaves the sensor only with `full`, for viewers. All strategies that the paper
compares are settings of this class, so that they are measured in the same way at the same pixel
budget.
"""

import math
import uuid
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from drivers.commands import Commanded, CommandTable, counts_of
from drivers.readout import exposure_of
from drivers.scan import scan_window
from drivers.sensor import EMPTY_WINDOW, FURTHER, Capabilities, Exposure, Mode
from drivers.simulated.coverage import Coverage, where
from drivers.simulated.further import FurtherWindows, read_further
from drivers.simulated.playback import Playback, Timing
from drivers.simulated.prefetch import Ready
from drivers.simulated.readout import Readout
from drivers.simulated.settings import MOSAICS, RATES_HZ, SimulatedSensorSettings
from drivers.simulated.sources import open_recording, open_scene, scene_path, shown_by
from drivers.source import Annotations, FrameSource
from pipeline.boxes import roi_window
from pipeline.contract import HEADLINE, RATE, Loan
from pipeline.errors import DriverError, PoolExhausted, SettingsError
from pipeline.forecast import Forecast, PictureStream, pictures
from pipeline.messages import Frame, Header, RoiSchedule
from pipeline.pixel_formats import FORMATS

USUAL_RATE_HZ = 30.0  # of a source that has no rate of its own
MOST_LABELS = 8  # whose shares are told one by one


class SimulatedSensor:
    """A `DualStreamSensor`. In realtime late pictures are skipped and counted, never stretched."""

    settings_type: ClassVar[type[Any]] = SimulatedSensorSettings

    def __init__(self, settings: SimulatedSensorSettings) -> None:
        self._settings = settings
        self._source: FrameSource | None = None
        self._playback: Playback | None = None
        self._commands: CommandTable | None = None
        self._coverage = Coverage()
        self._windows: Counter[str] = Counter()
        self._further = FurtherWindows(settings.rois)
        self._emitted_px, self._full_px = 0, 1
        self._exposed = self._overrun = 0
        self._rate_hz = 0.0  # of base frames, from `start` on

    @property
    def shows(self) -> str:
        """The kind of scene that its source shows, empty where that is not known."""
        return shown_by(self._settings.source or scene_path(self._settings.scene))

    @property
    def source(self) -> str:
        """What the pictures come from, for a sentence about it."""
        return self._settings.path or self._settings.scene or self._settings.source

    def open(self, *, realtime: bool) -> None:
        """Open the source; raises `DriverError` or `SettingsError` when it cannot."""
        settings = self._settings
        self._realtime, self._stream = realtime, uuid.uuid4().hex
        self._source = source = _open_source(settings)
        if settings.size_px not in ((0, 0), source.size_px):
            raise DriverError(
                f"{settings.path or settings.scene}: expected {_by(settings.size_px)} as size_px "
                f"says, got {_by(source.size_px)}"
            )
        self._prepare(source)

    def capabilities(self) -> Capabilities:
        """What the settings make of it; needs `open`."""
        self._opened()
        found, geometry = self._sampling, self._geometry
        window_px = found.window_px
        return Capabilities(
            geometry=geometry,
            context_px=found.context_px,
            context_binning=geometry.width_px / found.context_px[0],
            roi_sizes_px=(window_px,) if any(window_px) else (),
            roi_binning=window_px[0] / found.roi_px[0] if any(window_px) else 1.0,
            rates_hz=RATES_HZ,
            pixel_formats=("rgb8", *self._mosaics()),
            lead_frames=1 + self._settings.latency_frames,
            rois=self._settings.rois,
        )

    def forecast(self) -> Forecast:
        """The streams, by the settings as far as they tell without the source."""
        settings, source = self._settings, self._source
        size_px = source.size_px if source else settings.size_px
        rate_hz = settings.rate_hz or (source.rate_hz or USUAL_RATE_HZ if source else 0.0)
        streams: dict[str, PictureStream] = {}
        interval, missing = 1, "" if rate_hz else "rate_hz"
        if size_px == (0, 0):
            missing = "size_px and rate_hz" if missing else "size_px"
        else:
            found, form = settings.sampling(size_px), settings.form.name
            interval = found.interval
            sides = {"context": found.context_px, "roi": found.roi_px}
            sides |= dict.fromkeys(FURTHER[: found.rois - 1], found.roi_px)
            sides |= {"full": size_px} if settings.full else {}
            streams = {n: pictures(px, form, rate_hz / interval) for n, px in sides.items()}
        return Forecast(
            streams=streams,
            note=f"{self.source} is not opened for its {missing}" if missing else "",
            rate_hz=rate_hz / interval,
            lead_frames=1 + settings.latency_frames,
        )

    def configure(self, mode: Mode) -> None:
        """Change rate or pixel format; the ROI's size follows from the settings."""
        can, changes = self.capabilities(), dict[str, Any]()
        if mode.roi_px not in ((0, 0), *can.roi_sizes_px):
            raise SettingsError(f"roi_px: expected one of {can.roi_sizes_px}, got {mode.roi_px}")
        if mode.rate_hz:
            changes["rate_hz"] = mode.rate_hz
        if mode.pixel_format not in ("", *can.pixel_formats):
            known = ", ".join(can.pixel_formats)
            raise SettingsError(f"pixel_format: expected {known}, got {mode.pixel_format}")
        if mode.pixel_format:
            raw = mode.pixel_format != "rgb8"
            changes |= {"mosaic": raw, "pixel_format": mode.pixel_format if raw else ""}
        self._settings = replace(self._settings, **changes)
        self._prepare(self._opened())

    def start(self) -> None:
        """Begin to decode; the clock of `realtime` starts with the first `read`."""
        source, settings = self._opened(), self._settings
        self._rate_hz = settings.rate_hz or source.rate_hz or USUAL_RATE_HZ
        timing = Timing(
            rate_hz=self._rate_hz,
            interval=self._sampling.interval,
            averaged=self._sampling.averaged,
            frames=settings.frames,
            loop=settings.loop,
            realtime=self._realtime,
        )
        self._playback = Playback(source, timing)

    def set_rois(self, schedule: RoiSchedule) -> None:
        """Command the windows of coming frames; any thread may call it."""
        if self._commands is None:
            raise DriverError("simulated sensor: set_rois needs open before it")
        self._commands.accept(schedule)

    def read(self, loan: Loan) -> Exposure | None:
        """The next exposure at its time; None after the last one."""
        if self._playback is None:
            raise DriverError("simulated sensor: read needs start before it")
        taken = self._playback.take()
        if taken is None:
            return None
        ready, stamp_ns = taken
        header = Header(
            stream=self._stream, seq=ready.seq, stamp_ns=stamp_ns, geometry=self._geometry
        )
        try:
            exposure = self._expose(header, ready, loan)
        except PoolExhausted:
            self._overrun += 1
            raise
        finally:
            self._playback.done(ready)
        self._exposed += 1
        if ready.truth is not None and any(self._sampling.window_px):
            windows = [frame.window for frame in exposure.further]
            self._coverage.add(ready.truth, exposure.roi.window, *windows)
        return exposure

    def stop(self) -> None:
        """End the stream."""
        if self._playback is not None:
            self._playback.stop()

    def close(self) -> None:
        """Release source and thread; safe after any outcome."""
        if self._playback is not None:
            self._playback.close()
        if self._source is not None:
            self._source.close()
            self._source = None

    def summary(self) -> Mapping[str, Any]:
        """Frames, pixels against the budget, commands, and how much of the truth the ROI saw.

        `elapsed` is source time in frames; `late` are those of `skipped` that the strategy did
        not leave out on purpose; `windows` counts the status of the ROI, `further_windows`
        what became of windows 2 to K.
        """
        played = self._playback
        elapsed = played.elapsed if played else 0
        return {
            **self._told(elapsed),
            "strategy": self._settings.strategy,
            "frames": {
                "exposed": self._exposed,
                "skipped": played.skipped if played else 0,
                "late": played.late if played else 0,
                "overrun": self._overrun,
                "elapsed": elapsed,
            },
            "pixels": {
                "budget": self._settings.share,
                "used": round(self._emitted_px / elapsed / self._full_px, 6) if elapsed else 0.0,
            },
            "commands": counts_of(self._commands),
            "windows": dict(self._windows),
            **self._further.summary(),
            "roi_coverage": self._coverage.shares(),
            "roi_coverage_frames": self._coverage.frames(),
        }

    def _mosaics(self) -> tuple[str, ...]:
        """The mosaics it can send: the order of its colours is given, their depth is not."""
        order = self._settings.form.order or "rggb"
        return tuple(name for name in MOSAICS if FORMATS[name].order == order)

    def _told(self, elapsed: int) -> dict[str, Any]:
        """The rate, and what the ROI saw as a sentence, as far as there is anything to tell."""
        if not elapsed:
            return {}
        asked_hz = self._rate_hz / self._sampling.interval
        achieved_hz = self._exposed / elapsed * self._rate_hz
        found: dict[str, Any] = {
            RATE: {"asked_hz": round(asked_hz, 3), "achieved_hz": round(achieved_hz, 3)}
        }
        if any(self._sampling.window_px) and self._exposed:
            shares = {n: v for n, v in self._coverage.shares().items() if n != "mean"}
            told = ", ".join(f"{name} {share:.1%}" for name, share in shares.items())
            if len(shares) > MOST_LABELS:  # texts, each a label of its own
                mean = sum(shares.values()) / len(shares)
                told = f"{mean:.1%}, the mean of {len(shares)} labels"
            found[HEADLINE] = (
                f"share of the true boxes inside the ROI: {told}"
                if told
                else "share of the objects inside the ROI: not known, the source has no truth"
            )
            label = self._settings.oracle_label
            if self._settings.strategy == "oracle" and label not in shares:
                found[HEADLINE] += f"; the oracle stayed in the middle: no {label} in the truth"
        return found

    def _opened(self) -> FrameSource:
        if self._source is None:
            raise DriverError("simulated sensor: not open")
        return self._source

    def _read_sizes(self) -> list[tuple[int, int]]:
        """Width and height of the pictures of an exposure."""
        found = self._sampling
        full = [self._opened().size_px] if self._settings.full else []
        return [found.context_px, found.roi_px, *full]

    def _prepare(self, source: FrameSource) -> None:
        settings = self._settings
        self._sampling = settings.sampling(source.size_px)
        self._full_px = math.prod(source.size_px)
        self._geometry = geometry = settings.geometry(source.size_px)
        self._readout = Readout(
            form=settings.form,
            noise=settings.noise,
            response=settings.response,
            seed=settings.seed,
            most_px=max(map(math.prod, self._read_sizes())),
        )
        self._commands = CommandTable(
            self._stream, geometry, latency_frames=settings.latency_frames, rois=settings.rois
        )
        middle = roi_window(np.array([side / 2 for side in source.size_px], np.float32), geometry)
        self._held = [middle] + [EMPTY_WINDOW] * (settings.rois - 1)

    def _expose(self, header: Header, ready: Ready, loan: Loan) -> Exposure:
        found, readout, seq = self._sampling, self._readout, header.seq
        whole = (0, 0, self._geometry.width_px, self._geometry.height_px)
        context = loan("context", readout.shape(found.context_px), readout.dtype)
        aim = Commanded(EMPTY_WINDOW, -1, "ok")
        further: tuple[Frame, ...] = ()
        roi = np.empty(readout.shape((0, 0)), readout.dtype)
        if any(found.roi_px):
            roi = loan("roi", readout.shape(found.roi_px), readout.dtype)
            lent = self._further.memory(loan, readout, found.roi_px)
            aim, *others = self._aims(seq, ready.truth)
            readout.read(ready.pixels, aim.window, roi, seq=seq, port=1)
            further = read_further(header, ready.pixels, others, lent, readout, found.roi_px)
        readout.read(ready.pixels, whole, context, seq=seq, port=0)
        self._emitted_px += found.emitted_px(1 + sum(frame.pixels.size > 0 for frame in further))
        exposure = exposure_of(
            header,
            context,
            roi,
            aim,
            pixel_format=readout.form_of(whole, found.context_px).name,
            roi_pixel_format=readout.form_of(aim.window, found.roi_px).name,
            truth=ready.truth,
        )
        full = self._whole(header, ready, loan, whole) if self._settings.full else None
        return replace(exposure, further=further, full=full) if further or full else exposure

    def _whole(
        self, header: Header, ready: Ready, loan: Loan, window: tuple[int, int, int, int]
    ) -> Frame:
        """The whole field at full resolution, for viewers: it does not count as read."""
        readout, size_px = self._readout, (window[2], window[3])
        out = loan("full", readout.shape(size_px), readout.dtype)
        readout.read(ready.pixels, window, out, seq=header.seq, port=0)
        form = readout.form_of(window, size_px).name
        return Frame(header=header, pixels=out, window=window, pixel_format=form)

    def _aims(self, seq: int, truth: Annotations | None) -> list[Commanded]:
        """Where the windows look in frame `seq`; what nothing covers holds the last ones."""
        if self._settings.rois == 1 or self._commands is None:
            return [self._aim(seq, truth)]
        found = self._further.effective(self._commands.look_up_all(seq, held=self._held))
        self._held = [aim.window for aim in found]
        self._windows[found[0].status] += 1
        return found

    def _aim(self, seq: int, truth: Annotations | None) -> Commanded:
        """Where the ROI looks in frame `seq`; what nothing covers holds the last window."""
        settings, geometry = self._settings, self._geometry
        found = Commanded(self._held[0], -1, "ok")
        if settings.strategy == "round_robin":
            found = Commanded(scan_window(seq, geometry), -1, "ok")
        elif settings.strategy == "oracle" and truth is not None:
            place = where(truth, settings.oracle_label)
            if place is not None:
                found = Commanded(roi_window(place, geometry), -1, "ok")
        elif settings.strategy == "foveated" and self._commands is not None:
            found = self._commands.look_up(seq, held=self._held[0])
        self._held = [found.window]
        self._windows[found.status] += 1
        return found


def _open_source(settings: SimulatedSensorSettings) -> FrameSource:
    if settings.source:
        return open_recording(settings.source, path=settings.path, options=settings.source_options)
    return open_scene(
        settings.scene,
        size_px=settings.size_px,
        rate_hz=settings.rate_hz,
        seed=settings.seed,
        length=None if settings.loop else settings.frames or None,
        options=settings.source_options,
    )


def _by(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}x{size_px[1]}"
