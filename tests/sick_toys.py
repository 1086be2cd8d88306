"""Operators with an illness each, to test what a supervisor does about them."""

import ctypes
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline import Frame, Input, Operator


@dataclass(frozen=True, kw_only=True)
class SickSettings:
    """Which illness, and from which frame on."""

    ill_from: int = 10
    kind: str = ""  # leak, deadlock, seize
    open_s: float = 0.0
    again: str = ""  # with a file there, opening takes open_s; without one it is made


class Sick(Operator[SickSettings, Frame]):
    """Passes frames on until it falls ill."""

    frame = Input(Frame, keep="every")

    def open(self) -> None:
        self.kept: list[bytearray] = []
        self.lock = threading.Lock()
        seen = Path(self.settings.again) if self.settings.again else None
        if seen is None or (seen.exists() and seen.read_text() == "once"):
            time.sleep(self.settings.open_s)
        if seen is not None:
            seen.write_text("twice" if seen.exists() else "once")

    def on_frame(self, frame: Frame) -> Frame:
        if frame.header.seq == self.settings.ill_from and self.settings.kind == "deadlock":
            self.lock.acquire()
            self.lock.acquire()
        if frame.header.seq == self.settings.ill_from and self.settings.kind == "seize":
            ctypes.PyDLL(None).sleep(1000)  # and keeps the interpreter from everybody
        if frame.header.seq > self.settings.ill_from and self.settings.kind == "leak":
            self.kept.append(bytearray(b"x") * 4_000_000)
        return replace(frame, pixels=frame.pixels)
