"""Minimal operators, for benches of the runtime itself."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any
from uuid import uuid4

import numpy as np

from pipeline import Frame, Header, Input, Message, Operator, SettingsError, Source


@dataclass(frozen=True, kw_only=True)
class MetronomeSettings:
    """The rate and the size of the pictures."""

    rate_hz: float = 50.0
    side_px: int = 64

    def __post_init__(self) -> None:
        if self.rate_hz <= 0:
            raise SettingsError(f"rate_hz: must be positive, got {self.rate_hz}")


class Metronome(Source[MetronomeSettings, Frame]):
    """Sends grey pictures at a steady rate."""

    def open(self) -> None:
        self.stream, self.seq, self.start_s = uuid4().hex, 0, time.monotonic()

    def produce(self) -> Mapping[str, Message]:
        side_px = self.settings.side_px
        due_s = self.start_s + self.seq / self.settings.rate_hz
        time.sleep(max(0.0, due_s - time.monotonic()))
        header = Header(stream=self.stream, seq=self.seq, stamp_ns=time.monotonic_ns())
        pixels = self.loan((side_px, side_px, 3), np.uint8)
        pixels[...] = self.seq % 251
        self.seq += 1
        return {"out": Frame(header=header, pixels=pixels, window=(0, 0, side_px, side_px))}

    def summary(self) -> Mapping[str, Any]:
        return {"frames": {"exposed": self.seq, "skipped": 0}}


@dataclass(frozen=True, kw_only=True)
class NoSettings:
    """There is nothing to set."""


class Forward(Operator[NoSettings, Frame]):
    """Sends every picture again."""

    frame = Input(Frame, keep="every")

    def on_frame(self, frame: Frame) -> Frame:
        return replace(frame, pixels=frame.pixels)


class Sink(Operator[NoSettings, None]):
    """Receives pictures and sends nothing."""

    frame = Input(Frame, keep="every")

    def on_frame(self, frame: Frame) -> None:
        pass


class Inspector(Operator[NoSettings, None]):
    """Compares every byte of a metronome's pictures with its expected value."""

    frame = Input(Frame, keep="every")

    def open(self) -> None:
        self.torn = 0

    def on_frame(self, frame: Frame) -> None:
        self.torn += int((frame.pixels != frame.header.seq % 251).any())

    def summary(self) -> Mapping[str, Any]:
        return {"torn": self.torn}
