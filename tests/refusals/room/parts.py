"""Minimal operators of a user, beside the graph files of the cases."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline import (
    Frame,
    Header,
    Input,
    Message,
    Operator,
    Output,
    Percept,
    RoiSchedule,
    SettingsError,
    Source,
)


@dataclass(frozen=True, kw_only=True)
class EyeSettings:
    """Rate and size of the pictures."""

    rate_hz: float = 50.0
    side_px: int = 16

    def __post_init__(self) -> None:
        if not 0 < self.rate_hz <= 1000:
            raise SettingsError(f"rate_hz: expected above 0 to 1000, got {self.rate_hz}")


class Eye(Source[EyeSettings, Mapping[str, Message]]):
    """Sends grey pictures in two streams."""

    live = ("rate_hz",)
    context = Output(Frame)
    roi = Output(Frame)
    schedule = Input(RoiSchedule, command=True)

    def open(self) -> None:
        self.seq = 0

    def on_schedule(self, schedule: RoiSchedule) -> None:
        pass

    def produce(self) -> Mapping[str, Message]:
        if self.realtime:
            time.sleep(1 / self.settings.rate_hz)
        header = Header(stream="eye", seq=self.seq, stamp_ns=time.monotonic_ns())
        self.seq += 1
        side_px = self.settings.side_px
        pixels = np.zeros((side_px, side_px, 3), np.uint8)
        frame = Frame(header=header, pixels=pixels, window=(0, 0, side_px, side_px))
        return {"context": frame, "roi": frame}


@dataclass(frozen=True, kw_only=True)
class WorkSettings:
    """One setting with a range, and two without."""

    gain: int = 1
    words: tuple[str, ...] = ()
    more: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.gain <= 9:
            raise SettingsError(f"gain: expected 0 to 9, got {self.gain}")


class Work(Operator[WorkSettings, Frame]):
    """Passes pictures on."""

    live = ("gain",)
    commands = ("recall", "break_down")
    frame = Input(Frame)

    def on_frame(self, frame: Frame) -> Frame:
        return replace(frame, pixels=frame.pixels)

    def do_recall(self, last: int = 1, *, doubled: bool = False) -> dict[str, int]:
        if last < 1:
            raise SettingsError(f"last: expected at least 1, got {last}")
        return {"last": last * (1 + doubled)}

    def do_break_down(self) -> None:
        raise ValueError("told to break")

    def on_settings(self, settings: WorkSettings) -> None:
        if settings.gain == 7:
            raise SettingsError("gain: 7 is not for a running operator")
        if settings.gain == 8:
            raise ValueError("told to break")
        self.settings = settings


class Unopened(Work):
    """Fails to open."""

    def open(self) -> None:
        raise OSError(5, "the device is gone")


class Wrong(Work):
    """Returns a value of the wrong type."""

    def on_frame(self, frame: Frame) -> Frame:
        return 42  # type: ignore[return-value]


class Pair(Operator[WorkSettings, Percept]):
    """Joins two pictures of one exposure."""

    left = Input(Frame)
    right = Input(Frame)

    def on_left_right(self, left: Frame, right: Frame) -> Percept:
        return Percept(
            header=left.header,
            boxes=np.zeros((0, 4), np.float32),
            ids=np.zeros(0, np.int32),
            scores=np.zeros(0, np.float32),
        )


class Steer(Operator[WorkSettings, RoiSchedule]):
    """Sends a sensor command for every percept."""

    percept = Input(Percept)

    def on_percept(self, percept: Percept) -> RoiSchedule:
        windows = np.array([[0, 0, 8, 8]], np.int32)
        return RoiSchedule(header=percept.header, first_seq=percept.header.seq + 1, windows=windows)


class Look(Operator[WorkSettings, None]):
    """Sends nothing."""

    frame = Input(Frame)

    def on_frame(self, frame: Frame) -> None:
        pass


class NoHandler(Operator[WorkSettings, None]):
    """Has an input without a handler."""

    frame = Input(Frame)


class Idle(Operator[WorkSettings, None]):
    """Has only an optional input."""

    frame = Input(Frame, optional=True)

    def on_frame(self, frame: Frame | None) -> None:
        pass


PLAIN = 5
