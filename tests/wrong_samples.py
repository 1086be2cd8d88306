"""Operators with wrong return values of every kind that the runtime must detect."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from pipeline import Frame, Geometry, Header, Input, Message, Operator, Output, Percept, Source


@dataclass(frozen=True, kw_only=True)
class WrongSettings:
    """What is wrong with an answer."""

    answer: str = ""


class Smaller(Frame):
    """A kind of frame that no schema knows."""


def percept(header: Header) -> Percept:
    return Percept(
        header=header, boxes=np.zeros((0, 4), np.float32), ids=np.zeros(0, np.int32),
        scores=np.zeros(0, np.float32),
    )  # fmt: skip


def wrong(answer: str, frame: Frame) -> Any:
    """Return the wrong answer of that name; the correct one for any other name."""
    pixels = frame.pixels
    answers = {
        "a number": lambda: 42,
        "a list": lambda: [frame],
        "an unknown output": lambda: {"oops": frame},
        "an unknown output of a mapping": lambda: MappingProxyType({"oops": None}),
        "a number for an output": lambda: {"out": 42},
        "another message": lambda: percept(frame.header),
        "a subclass": lambda: Smaller(header=frame.header, pixels=pixels),
        "another dtype": lambda: replace(frame, pixels=pixels.astype(np.float64)),
        "no array": lambda: replace(frame, pixels=pixels.tolist()),
        "another shape": lambda: replace(frame, pixels=pixels[:, :, :2]),
        "a number as a string": lambda: replace(frame, command_seq="7"),
        "a fraction": lambda: replace(frame, command_seq=7.5),
        "too short a tuple": lambda: replace(frame, window=(0, 0, 1)),
        "no string": lambda: replace(frame, status=None),
        "too great a number": lambda: replace(frame, command_seq=1 << 70),
        "written input": lambda: pixels.fill(0),
    }
    return answers[answer]() if answer in answers else frame


class Wrong(Operator[WrongSettings, Frame]):
    """Returns the answer that its settings name."""

    frame = Input(Frame, keep="every")

    def on_frame(self, frame: Frame) -> Any:
        return wrong(self.settings.answer, frame)


class Mute(Operator[WrongSettings, None]):
    """Has no output, but returns a value."""

    frame = Input(Frame, keep="every")

    def on_frame(self, frame: Frame) -> Any:
        return {"a message": frame}.get(self.settings.answer, 7)


class Beside(Operator[WrongSettings, None]):
    """Returns a value from the handler of an input that is not joined."""

    frame = Input(Frame, keep="every", join=False)

    def on_frame(self, frame: Frame) -> Any:
        return frame


class Named(Operator[WrongSettings, Mapping[str, Message]]):
    """Returns for one of its named outputs a message of the type of another."""

    frame = Input(Frame, keep="every")
    picture = Output(Frame)
    report = Output(Percept)

    def on_frame(self, frame: Frame) -> Any:
        if self.settings.answer == "a message":
            return frame
        return {"picture": frame, "report": frame}


class Deaf(Operator[WrongSettings, Frame]):
    """Has no handler for its input."""

    frame = Input(Frame, keep="every")


class Maker(Source[WrongSettings, Mapping[str, Message]]):
    """Makes frames; the settings name a wrong answer."""

    left = Output(Frame)
    right = Output(Frame)
    schedule = Input(Frame, command=True)

    def open(self) -> None:
        self.seq = -1

    def on_schedule(self, schedule: Frame) -> Any:
        return 7

    def produce(self) -> Any:
        self.seq += 1
        header = Header(stream="s", seq=self.seq, stamp_ns=1, geometry=Geometry())
        pixels = np.full((16, 16, 3), self.seq % 251, np.uint8)
        frame = Frame(header=header, pixels=pixels)
        later = replace(frame, header=replace(header, seq=self.seq + 1))
        answers: dict[str, Any] = {
            "a message": frame,
            "no message": {"left": None},
            "an unknown output": {"oops": frame},
            "another message": {"left": percept(header)},
            "two exposures": {"left": frame, "right": later},
            "no header": {"left": replace(frame, header=None)},  # type: ignore[arg-type]
            "a header of strings": {"left": replace(frame, header=replace(header, stamp_ns="x"))},  # type: ignore[arg-type]
            "another shape": {"left": replace(frame, pixels=pixels[0, 0])},
        }
        return answers.get(self.settings.answer, {"left": frame, "right": frame})
