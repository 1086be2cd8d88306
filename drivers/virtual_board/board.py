"""A virtual board: requests and bulk reads in, what the real one would answer out.

It keeps the protocol of `drivers/usb/PROTOCOL.md` and knows no transport: the pyusb backend, the
USB/IP device and the gadget are thin layers on top of it.
"""

import threading
import time
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from drivers.usb.errors import BadBlock
from drivers.usb.frame_header import Stream
from drivers.usb.requests import (
    BoardStatus,
    BoardTime,
    Configuration,
    Request,
    Schedule,
    State,
)
from drivers.usb.requests import (
    Fault as BoardFault,
)
from drivers.virtual_board.errors import Gone, Refused
from drivers.virtual_board.exposures import Exposures
from drivers.virtual_board.faults import Fault, FaultScript
from drivers.virtual_board.profiles import Profile
from drivers.virtual_board.sender import FrameSender, picture_px
from drivers.virtual_board.world import World
from pipeline.pixel_formats import BY_CODE

OpenWorld = Callable[[int, int], World]  # pixel format, most pixels of a picture -> world
WAKE_S = 0.05  # how often a bulk read looks whether something has become due
IDLE_NS = 10_000_000_000  # the same, where only a request can change that


class VirtualBoard:
    """One board. Safe to be called by several threads."""

    def __init__(
        self, profile: Profile, world: OpenWorld, *, faults: Iterable[Fault] = (),
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:  # fmt: skip
        self.profile, self.faults = profile, FaultScript(faults)
        self._open_world, self._world = world, None  # type: OpenWorld, World | None
        self._now_ns = now_ns
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)  # by a request: reads look again
        self._exposures: Exposures | None = None
        self._sender: FrameSender | None = None
        self._back_ns = 0  # when it is plugged in again
        self._link_free_ns = 0
        self.plugged_in = 1  # times
        self._configuration = self._effective(
            Configuration(
                rate_mhz=min(30_000, profile.can.rates_mhz[1]), roi_px=(0, 0),
                pixel_format=profile.can.formats[0], mode=profile.can.modes[0],
            )
        )  # fmt: skip

    @property
    def present(self) -> bool:
        """Whether it is plugged in."""
        return self._now_ns() >= self._back_ns

    # requests

    def ask(self, request: int, length: int) -> bytes:
        """Answer an IN request; raises `Refused` or `Gone`."""
        with self._lock:
            self._catch_up()
            answers: dict[int, Callable[[], bytes]] = {
                Request.CAPABILITIES: self.profile.can.pack,
                Request.CONFIGURATION: self._configuration.pack,
                Request.ACKNOWLEDGEMENT: lambda: self._running().acknowledgement.pack(),
                Request.TIME: lambda: self._time().pack(),
                Request.STATUS: lambda: self._status().pack(),
            }
            if request not in answers:
                raise Refused(f"unknown request {request:#x}")
            return answers[request]()[:length]

    def tell(self, request: int, value: int, data: bytes) -> None:
        """Do what an OUT request asks; raises `Refused` or `Gone`."""
        with self._lock:
            self._catch_up()
            try:
                if request == Request.CONFIGURE:
                    self._configure(Configuration.unpack(data))
                elif request == Request.START:
                    self._start(triggered=bool(value & 1))
                elif request == Request.STOP:
                    self._stop()
                elif request == Request.SCHEDULE:
                    self._running().accept(Schedule.unpack(data))
                elif request == Request.TRIGGER:
                    self._running().trigger(self._now_ns())
                else:
                    raise Refused(f"unknown request {request:#x}")
            except BadBlock as error:
                raise Refused(str(error)) from None
            finally:
                self._changed.notify_all()

    def clear_halt(self, stream: Stream) -> None:
        """Clear the halt of an end point: what follows is a header."""
        with self._lock:
            self._catch_up()
            if self._sender is not None:
                self._sender.clear_halt(stream)

    def reset(self) -> None:
        """Reset it: idle, as after plugging in."""
        with self._lock:
            self._catch_up()
            self._stop()

    def close(self) -> None:
        """Stop, and close what it looks at."""
        with self._lock:
            self._stop()

    # bulk reads

    def read(self, stream: Stream, memory: NDArray[np.uint8], timeout_s: float) -> int | None:
        """Send the next bytes of a stream; return their count, None when nothing came in time.

        A count below the size of the memory is a short packet. A read that waits while the board
        is stopped returns None at once. Raises `Halted`, `Gone` or `TooMuch`.
        """
        deadline_ns = self._now_ns() + round(timeout_s * 1e9)
        with self._changed:
            running = self._sender
            while True:
                self._catch_up()
                if running not in (None, self._sender):
                    return None
                running = self._sender
                count = running.send(stream, memory) if running else None
                left_ns = deadline_ns - self._now_ns()
                if count is not None:
                    break
                if left_ns <= 0:
                    return None
                self._changed.wait(max(min(left_ns, self._wait_ns(stream)) / 1e9, 1e-4))
        self._pace(count)
        return count

    def _pace(self, count: int) -> None:
        """Take the time that the link takes for so many bytes."""
        if not self.profile.paced or not self.profile.can.link_bytes_per_s:
            return
        with self._lock:
            begin_ns = max(self._now_ns(), self._link_free_ns)
            self._link_free_ns = begin_ns + round(count * 1e9 / self.profile.can.link_bytes_per_s)
            wait_ns = self._link_free_ns - self._now_ns()
        if wait_ns > 0:
            time.sleep(wait_ns / 1e9)

    def _wait_ns(self, stream: Stream) -> int:
        """How long a read should wait before it looks again, where no request wakes it."""
        running = self._exposures
        waiting = running.waiting[stream] if running else None
        if running is None or (running.triggered and not waiting):
            return IDLE_NS
        coming = waiting[0].ready_ns if waiting else running.due_ns(running.next)
        return max(0, min(coming - self._now_ns(), round(WAKE_S * 1e9)))

    # state

    def _catch_up(self) -> None:
        """Expose what was due, and let go wrong what the script says; raises `Gone`."""
        now_ns, running = self._now_ns(), self._exposures
        if not self.present:
            raise Gone("unplugged")
        if running is None:
            return
        running.advance(now_ns)
        if fault := self.faults.due("unplug", running.next - 1):
            self._back_ns = now_ns + round(fault.seconds * 1e9)
            self.plugged_in += 1
            self._stop()
            raise Gone("unplugged")
        if fault := self.faults.due("silence", running.next - 1):
            running.silent_until_ns = now_ns + round(fault.seconds * 1e9)
        if self.faults.due("broken", running.next - 1):
            running.broken = True

    def _running(self) -> Exposures:
        if self._exposures is None:
            raise Refused("not started")
        return self._exposures

    def _configure(self, wanted: Configuration) -> None:
        can = self.profile.can
        lowest, highest = can.rates_mhz
        sizes = [(size.width_px, size.height_px) for size in can.roi_sizes]
        if self._exposures is not None:
            raise Refused("started")
        if not lowest <= wanted.rate_mhz <= highest or wanted.pixel_format not in can.formats:
            raise Refused("no such rate or pixel format")
        if wanted.roi_px not in [(0, 0), *sizes] or wanted.mode not in can.modes:
            raise Refused("no such ROI or mode")
        if wanted.burst_frames > can.burst_frames:
            raise Refused("no such burst")
        self._configuration = self._effective(wanted)

    def _effective(self, wanted: Configuration) -> Configuration:
        def payload(size_px: tuple[int, int]) -> int:
            return BY_CODE[wanted.pixel_format].row_bytes(size_px[0]) * size_px[1]

        return Configuration(
            rate_mhz=wanted.rate_mhz, roi_px=wanted.roi_px, pixel_format=wanted.pixel_format,
            mode=wanted.mode, payload_crc=wanted.payload_crc, burst_frames=wanted.burst_frames,
            context_bytes=payload(self.profile.can.context_px),
            roi_bytes=payload(picture_px(self.profile.can, wanted.roi_px)),
        )  # fmt: skip

    def _start(self, *, triggered: bool) -> None:
        self._stop()
        can = self.profile.can
        roi_px = picture_px(can, self._configuration.roi_px)
        most = max(width * height for width, height in (roi_px, can.context_px))
        self._world = self._open_world(self._configuration.pixel_format, most)
        self._exposures = Exposures(
            self.profile, self._configuration, length=self._world.length, triggered=triggered,
            start_ns=self._now_ns(),
        )  # fmt: skip
        self._sender = FrameSender(
            can, self._configuration, self._exposures, self._world, self.faults, self._now_ns
        )

    def _stop(self) -> None:
        self._exposures = self._sender = None
        self._changed.notify_all()
        if self._world is not None:
            self._world.close()
            self._world = None

    def _time(self) -> BoardTime:
        following = self._exposures.next if self._exposures else 0
        return BoardTime(now_ns=self._now_ns(), next_exposure=following)

    def _status(self) -> BoardStatus:
        running = self._exposures
        return BoardStatus(
            state=running.state if running else State.IDLE,
            fault=BoardFault.SENSOR if running and running.broken else BoardFault.NONE,
            next_exposure=running.next if running else 0,
            dropped=(running.dropped[Stream.CONTEXT], running.dropped[Stream.ROI])
            if running else (0, 0),
        )  # fmt: skip
