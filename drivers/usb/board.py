"""A dual-stream board on USB: ROI schedules in, exposures of two frames out."""

import time
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.commands import check_count
from drivers.sensor import EMPTY_WINDOW, Capabilities, Exposure, Mode
from drivers.usb.board_forecast import UNKNOWN, board_of, forecast_of
from drivers.usb.board_settings import (
    DualStreamBoardSettings,
    backend_settings,
    known_formats,
)
from drivers.usb.capabilities import CaptureMode
from drivers.usb.errors import LinkError
from drivers.usb.frame_header import FrameFlag, FrameHeader
from drivers.usb.frame_memory import FrameMemory, Kind
from drivers.usb.session import Session
from pipeline.contract import RATE, Loan
from pipeline.errors import DriverError, PoolExhausted, SettingsError
from pipeline.forecast import Forecast
from pipeline.messages import Frame, Header, RoiSchedule

COMMANDS = ("accepted", "late", "foreign")


class DualStreamBoard:
    """A `DualStreamSensor` on USB 3; its wire protocol is in PROTOCOL.md.

    The stream goes on with the same id when the board was unplugged and is back: `seq` advances by
    the time that it was away.
    """

    settings_type: ClassVar[type[Any]] = DualStreamBoardSettings

    def __init__(self, settings: DualStreamBoardSettings) -> None:
        self._settings = settings
        self._session: Session | None = None
        self._windows: Counter[str] = Counter()
        self._delivered = self._overrun = self._foreign = self._read_ahead = 0
        self._started_ns = self._last_ns = 0

    @property
    def absent_until_s(self) -> float:
        """Until when it looks for a lost board, in `time.monotonic()`; 0: none is lost."""
        return self._session.absent_until_s if self._session else 0.0

    @property
    def shows(self) -> str:
        """The kind of scene before a virtual board; empty for a real one."""
        try:
            return str(getattr(backend_settings(self._settings), "shows", ""))
        except SettingsError:  # `open` raises it, where it is about this node
            return ""

    def open(self, *, realtime: bool) -> None:
        """Acquire the board; raises `DriverError` or `SettingsError` when it cannot."""
        self._realtime, self._stream = realtime, uuid.uuid4().hex
        self._session = session = Session(self._settings, realtime=realtime)
        # in lockstep nothing comes before it is asked for, and between previews no ROI comes
        live = session.wanted.mode is CaptureMode.LIVE
        self._memory = FrameMemory(ahead=realtime and live)

    def capabilities(self) -> Capabilities:
        """What the board can do in this mode; needs `open`."""
        session = self._opened()
        can = session.connection.can
        lowest, highest = can.rates_mhz
        return Capabilities(
            geometry=session.geometry,
            context_px=can.context_px,
            context_binning=can.width_px / can.context_px[0],
            roi_sizes_px=tuple((s.width_px, s.height_px) for s in can.roi_sizes),
            roi_binning=float(session.roi.binning),
            rates_hz=(lowest / 1000, highest / 1000),
            pixel_formats=tuple(form.name for form in known_formats(can)),
            lead_frames=can.lead_frames,
        )

    def forecast(self) -> Forecast:
        """The streams of the open board, or of the one that its backend is known to have."""
        settings, session = self._settings, self._session
        known = board_of(settings)
        if session is not None:
            connection = session.connection
            delay = known.readout_frames if known else 0.0
            kind = "" if settings.backend else connection.link.kind
            return forecast_of(settings, connection.can, readout_frames=delay, kind=kind)
        if known is not None:
            return forecast_of(settings, known.can, readout_frames=known.readout_frames)
        return Forecast(note=UNKNOWN, rate_hz=settings.rate_hz)

    def configure(self, mode: Mode) -> None:
        """Change rate, window or format; raises `SettingsError` with the figures."""
        wanted = replace(
            self._settings,
            rate_hz=mode.rate_hz or self._settings.rate_hz,
            roi_px=mode.roi_px if any(mode.roi_px) else self._settings.roi_px,
            pixel_format=mode.pixel_format or self._settings.pixel_format,
        )
        self._opened().adopt(wanted)
        self._settings = wanted

    def start(self) -> None:
        """Begin to expose."""
        self._opened().begin()
        self._started_ns = time.monotonic_ns()

    def set_rois(self, schedule: RoiSchedule) -> None:
        """Send the windows of coming frames; may be called by another thread than `read`.

        Raises `RefusedSchedule` for several in one exposure: the protocol has one ROI.
        """
        check_count(schedule, 1)
        if not len(schedule.windows):
            return
        if schedule.header.stream != self._stream:
            self._foreign += 1
            return
        self._opened().upload(schedule)

    def read(self, loan: Loan) -> Exposure | None:
        """The next exposure, in memory from `loan`; raises `DriverError` when the board is lost."""
        session = self._opened()
        while not session.stopped.is_set():
            try:
                headers = session.exposed()
                if headers is None:
                    continue
                if any(FrameFlag.END in header.flags for header in headers):
                    return None
                exposure = self._received(session, headers, loan)
                if exposure is not None:
                    return exposure
            except LinkError as error:
                session.recover(error)
        return None

    def stop(self) -> None:
        """End exposing; a `read` that waits in another thread returns None."""
        if self._session is not None:
            self._session.stopped.set()

    def close(self) -> None:
        """Release the board; safe after any outcome."""
        if self._session is not None:
            self._session.close()

    def summary(self) -> Mapping[str, Any]:
        """Figures of the run: frames, losses by reason, commands, windows and the link."""
        session = self._session
        if session is None:
            return {}
        counts = session.counts
        return {
            **self._rate(session),
            "frames": {
                "exposed": self._delivered, "lost": counts["lost"], "overrun": self._overrun,
            },
            "losses": {name: count for name, count in session.losses.items() if count},
            "commands": {**{n: counts[n] for n in COMMANDS[:2]}, "foreign": self._foreign},
            "refused_commands": counts["refused"],
            "windows": dict(self._windows),
            "link": {
                **{name: counts[name] for name in ("outages", "stalls", "resets", "silences")},
                "bytes": counts["bytes"],
                "read_ahead": self._read_ahead,  # exposures whose memory was lent in time
                "clock_error_ms": round(session.clock.error_ms, 3),
            },
        }  # fmt: skip

    def _rate(self, session: Session) -> dict[str, Any]:
        elapsed_s = (self._last_ns - self._started_ns) / 1e9
        bursts = session.wanted.mode is CaptureMode.RECORD  # which have no rate of delivery
        if not self._realtime or bursts or self._delivered < 2 or elapsed_s <= 0:
            return {}
        achieved_hz = round(self._delivered / elapsed_s, 3)
        return {RATE: {"asked_hz": session.wanted.rate_mhz / 1000, "achieved_hz": achieved_hz}}

    def _received(
        self, session: Session, headers: Sequence[FrameHeader], loan: Loan
    ) -> Exposure | None:
        """Return the exposure with its pixels; None when it is lost."""
        forms = [session.format_of(header) for header in headers]
        kinds: list[Kind] = [
            (h.stream, form.shape(h.size_px), form.dtype)
            for h, form in zip(headers, forms, strict=True)
        ]
        self._read_ahead += self._memory.ready
        try:
            memory = self._memory.take(kinds, loan)
        except PoolExhausted:
            self._overrun += 1
            session.skip(headers)
            raise
        whole = False
        try:
            whole = session.fill(headers, memory, self._memory.lend(kinds, loan))
        finally:
            if not whole:
                self._memory.return_lost([header.stream for header in headers], memory)
        if not whole:
            return None
        self._delivered += 1
        return self._exposure(session, headers, memory, [form.name for form in forms])

    def _exposure(
        self, session: Session, headers: Sequence[FrameHeader], memory: Sequence[NDArray[Any]],
        names: Sequence[str],
    ) -> Exposure:  # fmt: skip
        self._last_ns = stamp_ns = session.clock.stamp_ns(headers[0].stamp_ns)
        header = Header(
            stream=self._stream, seq=session.first_seq + headers[0].exposure, stamp_ns=stamp_ns,
            geometry=session.geometry,
        )  # fmt: skip
        context = Frame(
            header=header, pixels=memory[0], pixel_format=names[0], window=headers[0].window
        )
        if len(headers) == 1:
            empty = np.empty(session.format.shape((0, 0)), session.format.dtype)
            roi = Frame(header=header, pixels=empty, pixel_format=names[0], window=EMPTY_WINDOW)
            return Exposure(header=header, context=context, roi=roi)
        status = headers[1].window_status.name.lower()
        self._windows[status] += 1
        roi = Frame(
            header=header, pixels=memory[1], pixel_format=names[1], window=headers[1].window,
            command_seq=session.command_of(headers[1]) if status == "ok" else -1, status=status,
        )  # fmt: skip
        return Exposure(header=header, context=context, roi=roi)

    def _opened(self) -> Session:
        if self._session is None:
            raise DriverError("usb: the board is not open")
        return self._session
