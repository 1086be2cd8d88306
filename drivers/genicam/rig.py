"""A camera that takes aimed frames one by one: aim in, the picture of the aim of L frames ago out.

L is the camera's command latency in frames. No vendor states it, so it is measured when the camera
is opened, by the offset that the frames themselves contain.
"""

import contextlib
import math
import time
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from drivers.genicam.clock import CameraClock
from drivers.genicam.device import Device
from drivers.genicam.formats import CameraFormat
from drivers.genicam.foveation import Foveation, reduced
from drivers.genicam.intake import Shape
from drivers.genicam.steering import Offset, Sets, Steering, Writes
from drivers.genicam.stream import Arrived, Stream
from pipeline.errors import DriverError

MOST_LATENCY = 8  # frames
TRIES = 3  # frames in a row that may be incomplete before the camera counts as lost

A = TypeVar("A")


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Sizes that follow from a camera and the reduction factor."""

    factor: int  # sensor pixels per context pixel, along one side
    size_px: tuple[int, int]  # of context and ROI: the payload is constant
    step_px: int  # of windows, as far as offsets go

    @property
    def field_px(self) -> tuple[int, int]:
        """The part of the sensor that the context shows."""
        return self.size_px[0] * self.factor, self.size_px[1] * self.factor

    @property
    def free_px(self) -> tuple[int, int]:
        """The furthest offset of a window."""
        width, height = self.field_px
        return width - self.size_px[0], height - self.size_px[1]


def layout(key: str, can: Foveation, factor: int, *, mosaic: bool, multiple_px: int = 1) -> Layout:
    """Choose the factor nearest to the wish; raises `DriverError` where there is none.

    Widths are multiples of `multiple_px`, besides the camera's own steps.
    """
    steps = math.lcm(can.size_step_px[0], multiple_px), can.size_step_px[1]
    usable = [f for f in can.factors if all(reduced(can.field_px, f, steps))] if all(steps) else []
    if not (usable and all(can.field_px) and all(can.size_step_px) and all(can.offset_step_px)):
        raise DriverError(
            f"{key}: expected a field, steps and a {can.reduction.lower()} above 1, got field "
            f"{can.field_px}, steps {can.size_step_px} and {can.offset_step_px}, factors {usable}"
        )
    if factor and factor not in usable:
        raise DriverError(f"{key}: binning: expected one of {usable}, got {factor}")
    chosen = factor or min(usable, key=lambda f: (abs(f - 4), f))
    # a step that both axes have; an even one keeps the phase of a mosaic
    step = math.lcm(*can.offset_step_px, 2 if mosaic else 1)
    return Layout(factor=chosen, size_px=reduced(can.field_px, chosen, steps), step_px=step)


class Lost(DriverError):
    """The camera does not answer any more."""


class Rig(Generic[A]):
    """An open camera under software triggers. `A` tells what a frame was aimed for."""

    def __init__(
        self,
        device: Device,
        can: Foveation,
        form: CameraFormat,
        plan: Layout,
        *,
        buffers: int,
        packet_bytes: int,
        answer_s: float,
    ) -> None:
        self.device, self.verdict, self.form, self.plan = device, can, form, plan
        self._answer_s = answer_s
        self._shape = Shape(size_px=plan.size_px, form=form)
        self._stream: Stream | None = None
        self.incomplete = self.latency = 0
        self.clock = CameraClock()
        self._aimed: deque[A] = deque()
        try:
            self._steering = _steering(device, can, plan)
            self._begin(buffers, packet_bytes)
        except BaseException:
            self.close()
            raise

    @property
    def step_px(self) -> int:
        """Windows start at multiples of it."""
        return self._steering.step_px

    def next(self, offset: Offset | None, purpose: A) -> tuple[Arrived, A] | None:
        """Aim, take a frame, and return it with the purpose of the aim that it shows.

        None: the first frames of a camera with latency show no aim yet. Give the frame to `drop`.
        """
        self._aimed.append(purpose)
        arrived = self._taken(offset)
        if len(self._aimed) <= self.latency:
            self.drop(arrived)
            return None
        return arrived, self._aimed.popleft()

    def drop(self, arrived: Arrived) -> None:
        """Let the camera fill the buffer of a frame again."""
        if self._stream is not None:
            self._stream.give_back(arrived)

    def stamp_ns(self, arrived: Arrived) -> int:
        """When the frame was made, in CLOCK_MONOTONIC."""
        stamp_ns = arrived.chunks.get("Timestamp", arrived.stamp_ns)
        return self.clock.monotonic_ns(stamp_ns, arrived.arrived_ns)

    def close(self) -> None:
        """End exposing and release the device."""
        stream, self._stream = self._stream, None
        if stream is not None:
            with contextlib.suppress(DriverError):  # it may be lost in this moment
                if not self.device.lost.is_set():
                    self.device.acquire(False)
            stream.close()
        self.device.close()

    def _begin(self, buffers: int, packet_bytes: int) -> None:
        device, (width, height) = self.device, self.plan.size_px
        with contextlib.suppress(DriverError):  # some have only this trigger, and no selector
            device.write("TriggerSelector", "FrameStart")
        device.write("TriggerMode", "On")
        device.write("TriggerSource", "Software")
        for name, value in (("OffsetX", 0), ("OffsetY", 0), ("Width", width), ("Height", height)):
            device.write(name, value)
        self._steering.prepare()
        self._steering.aim(None)
        parser = device.enable_chunks()
        self._stream = device.stream(buffers, parser, packet_bytes)
        device.acquire(True)
        self.latency = self._measured()

    def _measured(self) -> int:
        """Frames until a new offset shows; raises `DriverError` for a camera that ignores it."""
        step = self._steering.step_px
        far = self.plan.free_px[0] // step * step, self.plan.free_px[1] // step * step
        self.drop(self._taken(None))
        return max(self._frames_until(offset) for offset in (far, None, far, None))

    def _frames_until(self, offset: Offset | None) -> int:
        for count in range(MOST_LATENCY + 1):
            arrived = self._taken(offset)
            self.drop(arrived)
            if shown(arrived) == (offset or (0, 0)):
                return count
        raise DriverError(
            f"{self.device.key}: expected offset {offset or (0, 0)} within {MOST_LATENCY} frames, "
            f"got {shown(arrived)}: it cannot foveate"
        )

    def _taken(self, offset: Offset | None) -> Arrived:
        """One good frame after an aim; raises `Lost` when none comes."""
        stream = self._stream
        if stream is None:
            raise Lost(f"{self.device.key}: expected an open camera, got a closed one")
        self._steering.aim(offset)
        fault = "no answer"
        for _ in range(TRIES):
            while (late := stream.pop(0)) is not None:  # of a trigger that was given up
                stream.give_back(late)
            self.device.execute("TriggerSoftware")
            arrived = self._waited(stream)
            if arrived is not None:
                fault = self._shape.fault(arrived)
                if not fault:
                    return arrived
                stream.give_back(arrived)
                if fault == "unfitting":
                    raise DriverError(
                        f"{self.device.key}: expected frames of {self.plan.size_px}, got "
                        f"{arrived.width_px, arrived.height_px}: its payload is not constant, it "
                        "cannot foveate"
                    )
            self.incomplete += 1
        raise Lost(f"{self.device.key}: expected a frame after its trigger, got {fault}")

    def _waited(self, stream: Stream) -> Arrived | None:
        deadline_s = time.monotonic() + self._answer_s
        while (left_s := deadline_s - time.monotonic()) > 0 and not self.device.lost.is_set():
            arrived = stream.pop(min(left_s, 0.1))
            if arrived is not None:
                return arrived
        return None


def shown(arrived: Arrived) -> Offset:
    """The offset that the frame itself states, in its chunks or in its leader."""
    x, y = arrived.offset_px
    return arrived.chunks.get("OffsetX", x), arrived.chunks.get("OffsetY", y)


def _steering(device: Device, can: Foveation, plan: Layout) -> Steering:
    if can.means == "writes":
        return Writes(device, can, plan.factor, plan.step_px)
    return Sets(device, can, plan.factor, step_px=plan.step_px, free_px=plan.free_px)
