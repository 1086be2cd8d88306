"""A started board, kept alive: configured, in step, found again when it was lost.

Every failure of the link ends in one of three ways: what was lost is counted and the next frame is
looked for; the board is opened anew and gets the newest schedule again; or a `DriverError`.
"""

import logging
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.commands import rows_of
from drivers.usb.board_settings import (
    DualStreamBoardSettings,
    backend_settings,
    configuration,
    picture_px,
    pixel_format,
    roi_size,
)
from drivers.usb.capabilities import CaptureMode
from drivers.usb.clock import BoardClock
from drivers.usb.connection import Connection
from drivers.usb.errors import BadBlock, LinkError, NoAnswer, NoUsbMemory, Stalled, Unplugged
from drivers.usb.frame_header import FrameFlag, FrameHeader, Stream
from drivers.usb.losses import Losses
from drivers.usb.receiver import Receiver
from drivers.usb.requests import MOST_ENTRIES, Answer, Schedule
from drivers.usb.silence import Silence
from pipeline.boxes import centres, roi_window
from pipeline.errors import DriverError, SettingsError
from pipeline.import_path import imported
from pipeline.messages import Geometry, RoiSchedule
from pipeline.pixel_formats import BY_CODE, PixelFormat

POLL_S = 0.1  # how long a read waits before it looks whether it was stopped
STALL_AGAIN_S = 1.0  # a second stall within it resets the board
BACKOFF_S = (0.05, 2.0)  # first and longest pause between attempts to find the board again
SYNC_S = 1.0  # between exchanges of times
REMEMBERED = 256  # schedules whose frames may still come

log = logging.getLogger(__name__)


class Session:
    """The link side of a `DualStreamBoard`. `upload` may be called by another thread."""

    def __init__(self, settings: DualStreamBoardSettings, *, realtime: bool) -> None:
        self._settings, self._realtime = settings, realtime
        self._backend = _backend(settings)
        self._connection: Connection | None = None
        self._lock = threading.RLock()  # connection and schedules, against another thread
        self._pending: dict[Stream, FrameHeader] = {}
        self._schedules: OrderedDict[int, int] = OrderedDict()  # its id -> seq of the command
        self._newest: RoiSchedule | None = None
        self._schedule_id = 0
        self._stalled_s = 0.0
        self._triggered = False  # an exposure was asked for that has not come
        self._recorded = False  # the last frame was one of a burst
        self.absent_until_s = 0.0  # until when a lost board is looked for; 0: none is lost
        self.stopped = threading.Event()
        self.clock = BoardClock()
        self.counts: Counter[str] = Counter()
        self.losses = Losses()
        self.first_seq = 0  # of exposure 0
        self.last_seq = -1  # newest that came
        self.connect()

    def connect(self) -> None:
        """Find the board and open it; raises `DriverError` or `SettingsError`."""
        found = Connection(
            self._backend, serial=self._settings.serial, in_flight=self._settings.in_flight
        )
        try:
            self.adopt(self._settings, found)
        except BaseException:
            found.close()
            raise
        self._connection = found

    def adopt(
        self, settings: DualStreamBoardSettings, connection: Connection | None = None
    ) -> None:
        """Derive geometry and formats; raises `SettingsError` for what the board cannot do."""
        can = (connection or self.connection).can
        self.wanted = configuration(settings, can)
        self._settings = settings
        self.roi, self.format = roi_size(settings, can), pixel_format(settings, can)
        self.geometry = Geometry(
            width_px=can.width_px, height_px=can.height_px, roi_width_px=self.roi.width_px,
            roi_height_px=self.roi.height_px, step_px=can.step_px,
        )  # fmt: skip
        # a mosaic that is cropped at odd pixels begins with another colour
        self._formats = {self.format.shifted(x, y) for x in (0, 1) for y in (0, 1)}
        self._streams = list(Stream) if self.roi.width_px else [Stream.CONTEXT]

    @property
    def connection(self) -> Connection:
        """The open connection; raises `DriverError` when there is none."""
        if self._connection is None:
            raise DriverError("usb: the board is not open")
        return self._connection

    def begin(self) -> None:
        """Configure and start; exposures count from 0."""
        with self._lock:
            connection = self.connection
            effective = connection.configure(self.wanted)
            sizes = {Stream.CONTEXT: connection.can.context_px, Stream.ROI: picture_px(self.roi)}
            expected = {s: self.format.row_bytes(w) * h for s, (w, h) in sizes.items()}
            got = {Stream.CONTEXT: effective.context_bytes, Stream.ROI: effective.roi_bytes}
            if expected != got:
                raise LinkError(f"{connection.where}: expected payloads of {expected}, got {got}")
            slowest = max(connection.can.link_bytes_per_s, 1e8)
            self._payload_s = 1.0 + 4 * sum(got.values()) / slowest
            self._receiver = Receiver(connection.link, got, self.losses)
            self._pending, self._dropped, self._triggered = {}, 0, False
            self.clock.ask(connection.time_ns)
            connection.start(triggered=not self._realtime)
            self._silence = Silence(
                connection, self.wanted, self._receiver.exposure_bytes, self.counts
            )

    def close(self) -> None:
        """Stop the board and release it; safe after any outcome."""
        self.stopped.set()
        with self._lock:
            connection, self._connection = self._connection, None
        if connection is not None:
            try:
                connection.stop()
            except LinkError as error:
                log.debug("stopping the board: %s", error)
            connection.close()

    # commands

    def upload(self, schedule: RoiSchedule) -> None:
        """Send a schedule, and count what becomes of it; a refused one is not sent again."""
        with self._lock:
            before, self._newest = self._newest, schedule
            try:
                self._send(schedule)
            except (Stalled, BadBlock):
                self.counts["refused"] += 1
                self._newest = before
            except LinkError as error:  # the reader finds the link broken, and sends it again
                log.debug("a schedule was not sent: %s", error)

    def command_of(self, header: FrameHeader) -> int:
        """Return the seq of the command that set a window; -1: none."""
        return self._schedules.get(header.schedule_id, -1)

    def _send(self, schedule: RoiSchedule) -> None:
        first, made_from = (s - self.first_seq for s in (schedule.first_seq, schedule.header.seq))
        windows = rows_of(schedule.windows)[max(0, -first) :, 0]
        if not len(windows) or self._connection is None:
            return
        if len(windows) > MOST_ENTRIES:
            raise BadBlock(f"schedule: expected at most {MOST_ENTRIES} windows, got {len(windows)}")
        corners = [roi_window(c, self.geometry)[:2] for c in centres(windows.astype(np.float32))]
        self._schedule_id += 1
        self._schedules[self._schedule_id] = schedule.header.seq
        while len(self._schedules) > REMEMBERED:
            self._schedules.popitem(last=False)
        found = self._connection.schedule(
            Schedule(
                schedule_id=self._schedule_id, first=max(0, first), made_from=max(0, made_from),
                corners=tuple(corners),
            )
        )  # fmt: skip
        reason = {Answer.LATE: "late", Answer.REFUSED: "refused"}.get(found.answer, "accepted")
        self.counts[reason] += 1

    # frames

    def exposed(self) -> list[FrameHeader] | None:
        """The headers of the next complete exposure; None: not yet."""
        connection = self.connection
        if self.clock.age_s > SYNC_S:
            self.clock.ask(connection.time_ns)
        if not self._realtime and not self._triggered:
            connection.trigger()
            self._triggered = True
        missing = [stream for stream in self._streams if stream not in self._pending]
        before = len(self._pending)
        if missing:
            # a preview has no ROI to wait for, and only its own header says that it is one
            previews = self.wanted.mode is CaptureMode.RECORD
            self._pending |= self._receiver.headers(missing[:1] if previews else missing, POLL_S)
        if len(self._pending) > before:
            self._silence.heard()
        elif self._silence.asked():
            self._triggered = False
        return self._paired()

    def _paired(self) -> list[FrameHeader] | None:
        context, roi = self._pending.get(Stream.CONTEXT), self._pending.get(Stream.ROI)
        if any(h is not None and FrameFlag.END in h.flags for h in (context, roi)):
            return [h for h in (context, roi) if h is not None]
        if context is not None and FrameFlag.ALONE in context.flags:
            return [self._pending.pop(Stream.CONTEXT)]
        if context is None or roi is None:
            return None
        if context.exposure == roi.exposure:
            self._pending = {}
            return [context, roi]
        early = min((context, roi), key=lambda header: header.exposure)
        del self._pending[early.stream]
        alone = f"exposure {early.exposure}: only its {early.stream.name.lower()} has come"
        self.losses.lose("unpaired", alone)
        self._receiver.skip([early], self._payload_s)
        self._triggered = False
        return None

    def skip(self, headers: Sequence[FrameHeader]) -> None:
        """Read away the pixels of an exposure that has no place, and account for it."""
        self._account(headers)
        self._receiver.skip(headers, self._payload_s)
        self._triggered = False

    def format_of(self, header: FrameHeader) -> PixelFormat:
        """Return the format of a frame; raises `DriverError` for one that was not asked for."""
        found = BY_CODE.get(header.pixel_format)
        if found is None or found not in self._formats:
            got = found.name if found else f"{header.pixel_format:#010x}"
            raise DriverError(
                f"{self.connection.where}: {header.stream.name.lower()}: expected "
                f"{self.format.name} as configured, got {got}"
            )
        return found

    def fill(
        self, headers: Sequence[FrameHeader], memory: Sequence[NDArray[Any]],
        ahead: Mapping[Stream, NDArray[Any]] | None = None,
    ) -> bool:  # fmt: skip
        """Read the pixels of an exposure into memory; False: it is lost.

        `ahead` as in `Receiver.payloads`.
        """
        self._triggered = False
        for header, given in zip(headers, memory, strict=True):
            if given.nbytes != header.payload_bytes:
                got = header.payload_bytes
                raise LinkError(f"{header.stream.name}: expected {given.nbytes} bytes, got {got}")
        wanted = [(header, _flat(given)) for header, given in zip(headers, memory, strict=True)]
        coming = None if ahead is None else {name: _flat(given) for name, given in ahead.items()}
        whole = self._receiver.payloads(wanted, self._payload_s, coming)
        if whole:
            self._account(headers)
            self.counts["bytes"] += sum(header.payload_bytes for header in headers)
        return whole

    def _account(self, headers: Sequence[FrameHeader]) -> None:
        """Count what is missing before this exposure."""
        seq = self.first_seq + headers[0].exposure
        recorded = FrameFlag.RECORDED in headers[0].flags
        together = self.wanted.mode is CaptureMode.LIVE or (recorded and self._recorded)
        if together and self.last_seq >= 0:  # between previews exposures are not sent
            self.counts["lost"] += max(0, seq - self.last_seq - 1)
        self._recorded = recorded
        dropped = max(header.dropped for header in headers)
        if dropped > self._dropped:
            said = f"the board has dropped frames before exposure {headers[0].exposure}"
            self.losses.lose("dropped", said, dropped - self._dropped)
        self._dropped = dropped
        self.last_seq = max(self.last_seq, seq)

    # failures

    def recover(self, error: LinkError) -> None:
        """Do what a failure of the link needs; raises `DriverError` when nothing helps."""
        self._pending, self._triggered = {}, False
        if isinstance(error, Stalled):
            self._unstall(error)
        elif isinstance(error, (Unplugged, NoAnswer)):
            self._reconnect(error)
        elif isinstance(error, NoUsbMemory):
            raise error
        else:
            self.losses.lose("link", str(error))
            self._receiver.search()  # what was announced may still come

    def _unstall(self, error: Stalled) -> None:
        """Clear a halt; reset the board when it halts again at once."""
        now_s = time.monotonic()
        again = now_s - self._stalled_s < STALL_AGAIN_S
        self._stalled_s = now_s
        self.counts["stalls"] += 1
        self.losses["stall"] += 1
        log.warning("%s: %s", error, "the board is reset" if again else "the halt is cleared")
        try:
            if again:
                self.counts["resets"] += 1
                self.connection.link.reset()
                raise Unplugged("the board was reset")
            for stream in self._streams:
                self.connection.link.clear_halt(stream)
            self._receiver.search()
        except LinkError as failure:
            self._reconnect(failure)

    def _reconnect(self, error: LinkError) -> None:
        """Look for the board until it is back; raises `DriverError` when it stays away."""
        self.counts["outages"] += 1
        log.warning("%s: looking for the board again", error)
        lost_s, pause_s = time.monotonic(), BACKOFF_S[0]
        self.absent_until_s = lost_s + self._settings.reconnect_s
        with self._lock:
            connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
        while not self.stopped.wait(pause_s):
            pause_s = min(2 * pause_s, BACKOFF_S[1])
            away_s = time.monotonic() - lost_s
            try:
                self._resume(away_s)
            except DriverError as failure:
                if away_s > self._settings.reconnect_s:
                    away = f"not back after {away_s:.0f} s"
                    raise DriverError(f"{error}; {away}: {failure}") from None
            else:
                self.absent_until_s = 0.0
                log.warning("%s: the board is back after %.2f s", self.connection.where, away_s)
                return

    def _resume(self, away_s: float) -> None:
        """Open the board anew, in the same stream of frames, with the newest schedule."""
        with self._lock:
            self.connect()
            missed = round(away_s * self.wanted.rate_mhz / 1000) if self._realtime else 0
            self.first_seq = self.last_seq + 1 + missed
            self.clock.forget()
            try:
                self.begin()
                if self._newest is not None:
                    self._send_again(self._newest)
            except BaseException:
                opened, self._connection = self.connection, None
                opened.close()  # else the next attempt finds the board in use
                raise

    def _send_again(self, schedule: RoiSchedule) -> None:
        try:
            self._send(schedule)
        except (Stalled, BadBlock):  # the board may have other limits than before
            self.counts["refused"] += 1


def _flat(memory: NDArray[Any]) -> NDArray[np.uint8]:
    return memory.reshape(-1).view(np.uint8)


def _backend(settings: DualStreamBoardSettings) -> Any:
    """Return the backend of pyusb that the settings name; None: libusb."""
    if not settings.backend:
        return None
    found = imported(settings.backend, SettingsError, "backend")
    return found(backend_settings(settings))
