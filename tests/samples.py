"""Small operators to test the runtime: a source of numbered pictures, and their consumers."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from pipeline import (
    DriverError,
    Frame,
    Geometry,
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

GEOMETRY = Geometry(width_px=64, height_px=48, roi_width_px=16, roi_height_px=12)


@dataclass(frozen=True, kw_only=True)
class TickerSettings:
    """Rate, size and faults of a ticker."""

    rate_hz: float = 100.0
    side_px: int = 64
    length: int = 0
    fail_at: int = -1
    jam_at: int = -1  # the command at which it raises

    def __post_init__(self) -> None:
        if self.rate_hz <= 0:
            raise SettingsError(f"rate_hz: must be positive, got {self.rate_hz}")


class Ticker(Source[TickerSettings, Mapping[str, Message]]):
    """Two streams of pictures filled with their own number."""

    live = ("rate_hz",)

    context = Output(Frame)
    roi = Output(Frame)
    schedule = Input(RoiSchedule, command=True)

    def open(self) -> None:
        self.stream, self.seq, self.start_s = uuid4().hex, 0, 0.0
        self.newest = RoiSchedule(
            header=Header(stream="", seq=-1, stamp_ns=0),
            first_seq=0,
            windows=np.zeros((0, 4), np.int32),
        )
        self.commanded = 0

    def on_settings(self, settings: TickerSettings) -> None:
        self.settings = settings
        self.start_s = time.monotonic() - self.seq / settings.rate_hz

    def on_schedule(self, schedule: RoiSchedule) -> None:
        if schedule.header.seq >= self.settings.jam_at >= 0:
            raise DriverError("a command: jammed")
        self.newest = schedule
        self.commanded += 1

    def produce(self) -> Mapping[str, Message] | None:
        settings = self.settings
        if settings.length and self.seq >= settings.length:
            return None
        if self.realtime:
            self.start_s = self.start_s or time.monotonic()  # of the first picture
            due_s = self.start_s + self.seq / settings.rate_hz
            time.sleep(max(0.0, due_s - time.monotonic()))
        seq, self.seq = self.seq, self.seq + 1
        if seq == settings.fail_at:
            raise DriverError(f"picture {seq}: torn")
        header = Header(
            stream=self.stream, seq=seq, stamp_ns=time.monotonic_ns(), geometry=GEOMETRY
        )
        frames = {}
        for name in ("context", "roi"):
            pixels = self.loan((settings.side_px, settings.side_px, 3), np.uint8, name)
            pixels[...] = seq % 251
            window = (0, 0, 64, 48)
            frames[name] = Frame(header=header, pixels=pixels, window=window)
        return frames

    def summary(self) -> Mapping[str, Any]:
        return {"frames": {"exposed": self.seq, "skipped": 0}, "commanded": self.commanded}


@dataclass(frozen=True, kw_only=True)
class WorkSettings:
    """Delays and faults of a sample."""

    sleep_s: float = 0.0
    crash_at: int = -1
    crash_after: int = 0  # pictures that an instance handles before it crashes
    hang_at: int = -1
    every: int = 1  # only each nth picture is passed on
    hold: int = 0  # number of pictures kept
    gain: int = 1  # factor of the counts of a tally

    def __post_init__(self) -> None:
        if self.every < 1:
            raise SettingsError(f"every: must be at least 1, got {self.every}")


class Pass(Operator[WorkSettings, Frame]):
    """Passes pictures on."""

    live = ("every", "hold")
    commands = ("recall", "break_down")
    frame = Input(Frame, keep="latest")

    def open(self) -> None:
        self.held: list[Frame] = []
        self.handled = 0
        self.last: int | None = None

    def comes_to(self, seq: int, frame: int) -> bool:
        """Return whether `seq` is that frame, or the next one if a busy machine dropped it."""
        return seq == frame or (self.last is not None and self.last < frame <= seq)

    def on_settings(self, settings: WorkSettings) -> None:
        if settings.hold > 9:
            raise SettingsError("work.hold: no room for more than 9 pictures")
        if settings.hold < 0:
            raise ValueError("told to break")
        self.settings = settings

    def do_recall(self, last: int = 1, *, doubled: bool = False) -> dict[str, list[int]]:
        if last < 1:
            raise SettingsError(f"work.recall.last: must be at least 1, got {last}")
        return {"held": [frame.header.seq * (1 + doubled) for frame in self.held[-last:]]}

    def do_break_down(self) -> None:
        raise ValueError("told to break")

    def on_frame(self, frame: Frame) -> Frame | None:
        settings = self.settings
        if settings.sleep_s:
            time.sleep(settings.sleep_s)
        if self.comes_to(frame.header.seq, settings.crash_at):
            raise ValueError("told to crash")
        self.handled += 1
        if settings.crash_after and self.handled > settings.crash_after:
            raise ValueError("told not to live for long")
        if self.comes_to(frame.header.seq, settings.hang_at):
            time.sleep(1000)
        self.last = frame.header.seq
        self.held = [*self.held, frame][-settings.hold :] if settings.hold else []
        if frame.header.seq % settings.every:
            return None
        return replace(frame, pixels=frame.pixels)


class PassEvery(Pass):
    """Passes pictures on and loses none."""

    frame = Input(Frame, keep="every")


class Pair(Operator[WorkSettings, Percept]):
    """Joins two pictures of one exposure and sends a value of each."""

    left = Input(Frame, keep="latest")
    right = Input(Frame, keep="latest")

    def open(self) -> None:
        self.seen: list[int] = []

    def on_left_right(self, left: Frame, right: Frame) -> Percept:
        assert left.header.seq == right.header.seq
        values = np.array([left.pixels[0, 0, 0], right.pixels[-1, -1, -1]], np.float32)
        self.seen.append(left.header.seq)
        return Percept(
            header=left.header,
            boxes=np.zeros((0, 4), np.float32),
            ids=np.zeros(0, np.int32),
            scores=np.zeros(0, np.float32),
            action=values,
        )

    def summary(self) -> Mapping[str, Any]:
        return {"seen": self.seen[-2000:]}


class PairEvery(Pair):
    """Joins pictures and loses none."""

    left = Input(Frame, keep="every")
    right = Input(Frame, keep="every")


class Steer(Operator[WorkSettings, RoiSchedule]):
    """Sends a sensor command for every percept."""

    percept = Input(Percept, keep="every")

    def on_percept(self, percept: Percept) -> RoiSchedule:
        seq = percept.header.seq
        x = int(percept.action[0]) % 48
        return RoiSchedule(
            header=percept.header,
            first_seq=seq + 1,
            windows=np.array([[x, 0, x + 16, 12]] * 4, np.int32),
            scanpath_seq=seq,
        )


class Count(Operator[WorkSettings, None]):
    """Sends nothing; records which pictures arrived and how many of them were torn."""

    frame = Input(Frame, keep="every")

    def open(self) -> None:
        self.seen: list[int] = []
        self.torn = 0

    def on_frame(self, frame: Frame) -> None:
        if self.settings.sleep_s:
            time.sleep(self.settings.sleep_s)
        self.torn += int((frame.pixels != frame.header.seq % 251).any())
        self.seen.append(frame.header.seq)

    def summary(self) -> Mapping[str, Any]:
        return {"seen": self.seen[-5000:], "torn": self.torn}


@dataclass(frozen=True, kw_only=True)
class TallyState:
    """The state of a tally."""

    count: int
    marks: NDArray[np.int32]  # (n,) the last numbers


class Tally(Operator[WorkSettings, Percept]):
    """Sends the number of pictures so far for every picture; a successor takes over its state."""

    frame = Input(Frame, keep="every")

    def open(self) -> None:
        self.tally = TallyState(count=0, marks=np.zeros(0, np.int32))

    def state(self) -> TallyState:
        return self.tally

    def restore(self, state: TallyState) -> None:
        self.tally = state

    def on_frame(self, frame: Frame) -> Percept:
        seq = frame.header.seq
        if seq >= self.settings.crash_at >= 0:
            raise ValueError("told to crash")
        time.sleep(self.settings.sleep_s)
        count = self.tally.count + 1
        self.tally = TallyState(count=count, marks=np.array([seq], np.int32))
        return Percept(
            header=frame.header,
            boxes=np.zeros((0, 4), np.float32),
            ids=np.zeros(0, np.int32),
            scores=np.zeros(0, np.float32),
            action=np.array([self.settings.gain * count], np.float32),
        )


class Corrected(PassEvery):
    """Hears what a later node found in an earlier frame."""

    told = Input(Percept, join=False)

    def on_told(self, told: Percept) -> None:
        self.heard = told.header.seq


class Recall(Operator[WorkSettings, None]):
    """Records the counts of a tally by frame."""

    percept = Input(Percept, keep="every")

    def open(self) -> None:
        self.said: list[tuple[int, int]] = []

    def on_percept(self, percept: Percept) -> None:
        self.said.append((percept.header.seq, int(percept.action[0])))

    def summary(self) -> Mapping[str, Any]:
        return {"said": self.said}


class Stillborn(Count):
    """Fails to open."""

    def open(self) -> None:
        super().open()
        raise DriverError("never meant to live")


class Nosy(Steer):
    """An operator that no host allows."""


@dataclass(frozen=True, kw_only=True)
class ModelSettings:
    """A file, and another one to change to."""

    weights: str = ""
    spare: str = ""


class Model(Operator[ModelSettings, None]):
    """Does nothing; tests change its file."""

    live = ("weights",)
    frame = Input(Frame, keep="latest")

    def on_frame(self, frame: Frame) -> None:
        pass


@dataclass(frozen=True, kw_only=True)
class ComputedSettings:
    """What an operator says that its networks run on."""

    on: str = "tensorrt, cpu"


class Computed(Operator[ComputedSettings, None]):
    """Has a network, as it says."""

    frame = Input(Frame, keep="latest")

    def on_frame(self, frame: Frame) -> None:
        pass

    def runs_on(self) -> str:
        return self.settings.on
