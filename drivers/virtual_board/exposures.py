"""What a virtual board exposes when: its clock, its schedules and the frames that wait.

No thread runs in the background: every request and every read first makes the exposures that
became due since the last one, with the schedules that had arrived by then. They wait for the host
and are rendered when they are read; when too many wait, the oldest is dropped and counted.
"""

from collections import deque
from dataclasses import dataclass

from drivers.usb.capabilities import CaptureMode
from drivers.usb.frame_header import Stream, Window, WindowStatus
from drivers.usb.requests import Acknowledgement, Answer, Configuration, Schedule, State
from drivers.virtual_board.profiles import Profile

MOST_SCHEDULES = 256


@dataclass(frozen=True, kw_only=True)
class Exposed:
    """One exposure, not yet rendered."""

    exposure: int
    stamp_ns: int
    ready_ns: int  # when the host can read it
    window: Window
    schedule_id: int
    entry: int
    status: WindowStatus
    alone: bool  # a preview: no ROI belongs to it
    recorded: bool


class Exposures:
    """The exposures between START and STOP."""

    def __init__(
        self, profile: Profile, configuration: Configuration, *, length: int | None,
        triggered: bool, start_ns: int,
    ) -> None:  # fmt: skip
        self._profile, self._configuration = profile, configuration
        self._length, self.triggered, self._start_ns = length, triggered, start_ns
        self._period_ns = 1e12 / configuration.rate_mhz
        self._schedules: list[Schedule] = []
        self._held = self._centred()
        self._burst: range | None = None  # exposures of the coming or current recording
        self._answer = Acknowledgement(
            schedule_id=0, answer=Answer.NONE, first_entry=0, next_exposure=0
        )
        self.next = 0  # exposure
        self.silent_until_ns = 0
        self.broken = False
        self.waiting: dict[Stream, deque[Exposed]] = {stream: deque() for stream in Stream}
        self.dropped = dict.fromkeys(Stream, 0)

    @property
    def over(self) -> bool:
        """Whether the source has no further pictures."""
        return self._length is not None and self.next >= self._length

    @property
    def state(self) -> State:
        """What the board is doing."""
        if self._configuration.mode is CaptureMode.LIVE:
            return State.LIVE
        if self._burst is not None and self.next in self._burst:
            return State.RECORDING
        recorded = any(one.recorded for one in self.waiting[Stream.CONTEXT])
        return State.DOWNLOADING if recorded else State.PREVIEW

    @property
    def acknowledgement(self) -> Acknowledgement:
        """What became of the newest schedule."""
        return self._answer

    def due_ns(self, exposure: int) -> int:
        """When an exposure is ready, on the board's clock."""
        return self._start_ns + round((exposure + 1) * self._period_ns)

    def advance(self, now_ns: int) -> None:
        """Expose what has become due."""
        while not self.triggered and not self.over and self.due_ns(self.next) <= now_ns:
            self._expose(self.due_ns(self.next))

    def trigger(self, now_ns: int) -> None:
        """Expose until there is one more frame to send, or a failure lets none come."""
        before = len(self.waiting[Stream.CONTEXT]) + self.dropped[Stream.CONTEXT]
        while not self.over:
            self._expose(now_ns)
            if self.broken or now_ns < self.silent_until_ns:
                return
            if len(self.waiting[Stream.CONTEXT]) + self.dropped[Stream.CONTEXT] > before:
                return

    def accept(self, schedule: Schedule) -> None:
        """Take a schedule; what became of it is the acknowledgement."""
        answer, first = self._judge(schedule)
        if answer is not Answer.REFUSED:  # a late one still explains why a frame is stale
            place = len(self._schedules)
            while place and self._schedules[place - 1].made_from > schedule.made_from:
                place -= 1
            self._schedules.insert(place, schedule)
            del self._schedules[:-MOST_SCHEDULES]
        if answer in (Answer.ACCEPTED, Answer.PARTLY_LATE):
            self._plan_burst(schedule, first)
        self._answer = Acknowledgement(
            schedule_id=schedule.schedule_id, answer=answer, first_entry=first,
            next_exposure=self.next,
        )  # fmt: skip

    def _judge(self, schedule: Schedule) -> tuple[Answer, int]:
        can, (width, height) = self._profile.can, self._configuration.roi_px
        for x, y in schedule.corners:
            inside = x + width <= can.width_px and y + height <= can.height_px
            if not inside or x % can.step_px or y % can.step_px:
                return Answer.REFUSED, 0
        first = max(0, max(self.next, self._earliest(schedule)) - schedule.first)
        if first >= len(schedule.corners):
            return Answer.LATE, min(first, 65_535)
        return (Answer.PARTLY_LATE if first else Answer.ACCEPTED), first

    def _earliest(self, schedule: Schedule) -> int:
        return schedule.made_from + self._profile.can.lead_frames

    def _plan_burst(self, schedule: Schedule, first: int) -> None:
        busy = self.state in (State.RECORDING, State.DOWNLOADING)
        if self._configuration.mode is CaptureMode.RECORD and not busy:
            start = schedule.first + first
            most = self._configuration.burst_frames or self._profile.can.burst_frames
            self._burst = range(start, start + min(most, len(schedule.corners) - first))

    def _expose(self, stamp_ns: int) -> None:
        k, self.next = self.next, self.next + 1
        window, schedule_id, entry, status = self._aim(k)
        if self.broken or stamp_ns < self.silent_until_ns:
            return
        recorded = self._burst is not None and k in self._burst
        alone = self._configuration.mode is CaptureMode.RECORD and not recorded
        if alone and (self._downloading() or k % self._preview_interval()):
            return
        ready_ns = self.due_ns(self._burst[-1]) if recorded and self._burst else stamp_ns
        if not self.triggered:
            ready_ns += round(self._profile.readout_frames * self._period_ns)
        found = Exposed(
            exposure=k, stamp_ns=stamp_ns, ready_ns=0 if self.triggered else ready_ns,
            window=window, schedule_id=schedule_id, entry=entry, status=status, alone=alone,
            recorded=recorded,
        )  # fmt: skip
        streams = [Stream.CONTEXT] if alone or not any(self._configuration.roi_px) else list(Stream)
        for stream in streams:
            self._queue(stream, found)

    def _queue(self, stream: Stream, found: Exposed) -> None:
        waiting = self.waiting[stream]
        waiting.append(found)
        most = max(self._profile.buffer_frames, round(self._profile.readout_frames) + 2)
        if not found.recorded and len(waiting) > most:
            waiting.popleft()
            self.dropped[stream] += 1

    def _downloading(self) -> bool:
        return any(one.recorded for one in self.waiting[Stream.CONTEXT])

    def _preview_interval(self) -> int:
        return max(1, round(self._configuration.rate_mhz / (self._profile.can.preview_mhz or 1)))

    def _aim(self, k: int) -> tuple[Window, int, int, WindowStatus]:
        """Return window, schedule, entry and status of an exposure; the newest plan applies."""
        self._schedules = [s for s in self._schedules if s.first + len(s.corners) > k]
        covering = [s for s in self._schedules if s.first <= k]
        for schedule in reversed(covering):
            if self._earliest(schedule) <= k:
                entry = k - schedule.first
                self._held = self._window(*schedule.corners[entry])
                return self._held, schedule.schedule_id, entry, WindowStatus.OK
        status = WindowStatus.STALE if covering else WindowStatus.UNPLANNED
        return self._held, 0, 0, status

    def _window(self, x: int, y: int) -> Window:
        width, height = self._configuration.roi_px
        return x, y, x + width, y + height

    def _centred(self) -> Window:
        can, (width, height) = self._profile.can, self._configuration.roi_px
        x, y = (can.width_px - width) // 2, (can.height_px - height) // 2
        return self._window(x - x % can.step_px, y - y % can.step_px)
