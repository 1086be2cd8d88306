"""Drains a stream by a thread: buffers in, the newest good frame out.

A camera goes on while nobody reads. Without the thread, old frames would hold every buffer, and the
newest would be the ones that find no place.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from drivers.genicam.device import Device
from drivers.genicam.formats import CameraFormat, view
from drivers.genicam.stream import Arrived, Stream

POP_S = 0.05  # how soon the thread notices that it shall end
SILENT_S = 1.0  # without a frame the camera is asked whether it is still there


@dataclass(frozen=True, kw_only=True)
class Shape:
    """What a good frame looks like."""

    size_px: tuple[int, int]  # width, height
    form: CameraFormat

    def fault(self, arrived: Arrived) -> str:
        """Why a frame is not delivered: incomplete or unfitting; empty: it is good."""
        if arrived.status != "success":
            return "incomplete"
        if (arrived.width_px, arrived.height_px) != self.size_px or arrived.code != self.form.code:
            return "unfitting"
        return "" if view(arrived, self.form) is not None else "incomplete"


class Intake:
    """One thread from construction to `close`; `take` may be called by another one."""

    def __init__(
        self,
        device: Device,
        stream: Stream,
        shape: Shape,
        *,
        faults: Counter[str],
        lost: Callable[[str], None],
    ) -> None:
        self._device, self._stream, self._shape = device, stream, shape
        self._faults, self._lost = faults, lost
        self._arrival = threading.Condition()
        self._newest: Arrived | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._work, name="intake", daemon=True)
        self._thread.start()

    def take(self, timeout_s: float) -> Arrived | None:
        """The newest frame that was not taken; None: none in time. Give it back to `drop`."""
        with self._arrival:
            self._arrival.wait_for(lambda: self._newest is not None or self._ended, timeout_s)
            found, self._newest = self._newest, None
            return found

    def drop(self, arrived: Arrived) -> None:
        """Let the camera fill the buffer of a frame again."""
        self._stream.give_back(arrived)

    def close(self) -> None:
        """End the thread."""
        with self._arrival:
            self._ended = True
            self._arrival.notify_all()
        self._thread.join()

    def _work(self) -> None:
        seen_s = time.monotonic()
        while not self._ended:
            arrived = self._stream.pop(POP_S)
            now_s = time.monotonic()
            if arrived is not None:
                seen_s = now_s
                self._keep(arrived)
            elif self._device.lost.is_set() or now_s - seen_s > SILENT_S:
                if not self._device.answers():
                    self._device.lost.set()
                    self._lost(f"no frame for {now_s - seen_s:.1f} s and no answer")
                    return
                seen_s = now_s  # it may wait for a trigger

    def _keep(self, arrived: Arrived) -> None:
        fault = self._shape.fault(arrived)
        if fault:
            self._faults[fault] += 1
            self._stream.give_back(arrived)
            return
        with self._arrival:
            older, self._newest = self._newest, arrived
            self._arrival.notify_all()
        if older is not None:
            self._stream.give_back(older)
