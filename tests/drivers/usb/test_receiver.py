"""The receiver over a link that is played: packets that end early, and reads that fail ahead."""

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
import pytest

from drivers.usb.errors import Stalled
from drivers.usb.frame_header import FrameFlag, FrameHeader, Stream, WindowStatus
from drivers.usb.link import Link
from drivers.usb.losses import Losses
from drivers.usb.part import Part
from drivers.usb.receiver import Receiver
from pipeline.pixel_formats import FORMATS

SIZE_PX = (64, 16)
BYTES = SIZE_PX[0] * SIZE_PX[1]
Step = Callable[[Sequence[Part]], None]


class Played:
    """A link that does one step for each call, and notes what was read ahead."""

    def __init__(self, *steps: Step) -> None:
        self._steps = list(steps)
        self.ahead: list[list[Part]] = []
        self.cancelled: list[int] = []

    def receive(self, parts: Sequence[Part], _timeout_s: float, ahead: Sequence[Part] = ()) -> None:
        self.ahead.append(list(ahead))
        self._steps.pop(0)(parts)

    def cancel(self, stream: int) -> None:
        self.cancelled.append(stream)


def header(stream: Stream) -> FrameHeader:
    form = FORMATS["bayer_rggb8"]
    return FrameHeader(
        stream=stream, flags=FrameFlag(0), window_status=WindowStatus.OK, exposure=3, stamp_ns=0,
        window=(0, 0, *SIZE_PX), size_px=SIZE_PX, pixel_format=form.code, row_bytes=SIZE_PX[0],
        payload_bytes=BYTES, payload_crc=0, schedule_id=0, entry=0, dropped=0,
    )  # fmt: skip


def empty(parts: Sequence[Part]) -> None:
    parts[0].short = True


def headers(parts: Sequence[Part]) -> None:
    for part in parts:
        packed = header(Stream(part.stream)).pack()
        part.memory[: len(packed)] = np.frombuffer(packed, np.uint8)
        part.received, part.short = len(packed), True


def pixels(parts: Sequence[Part]) -> None:
    for part in parts:
        part.received = len(part)


def stall(_parts: Sequence[Part]) -> None:
    raise Stalled("an end point is halted")


def receiver(*steps: Step) -> tuple[Receiver, Played]:
    link = Played(*steps)
    sizes = dict.fromkeys(Stream, BYTES)
    return Receiver(cast(Link, link), sizes, Losses()), link


def test_an_empty_packet_before_a_header_is_read_past() -> None:
    subject, _ = receiver(empty, headers)
    subject.search()

    found = [subject.headers([Stream.CONTEXT], 1.0) for _ in range(2)]

    assert [list(each) for each in found] == [[], [Stream.CONTEXT]]


def test_what_follows_is_read_ahead_of_each_stream_in_turn() -> None:
    subject, link = receiver(headers, pixels, headers)
    memory = {stream: np.zeros(BYTES, np.uint8) for stream in Stream}
    found = subject.headers(list(Stream), 1.0)
    pictures = [(each, np.zeros(BYTES, np.uint8)) for each in found.values()]

    assert subject.payloads(pictures, 1.0, memory)
    subject.headers(list(Stream), 1.0)

    streams, sizes = zip(*((p.stream, len(p)) for p in link.ahead[1]), strict=True)
    assert streams == (0, 1, 0, 1)
    assert sizes[2:] == (BYTES, BYTES)
    assert [part.memory is memory[Stream(part.stream)] for part in link.ahead[2]] == [True, True]


def test_after_an_error_nothing_is_ahead_and_a_header_is_looked_for() -> None:
    subject, link = receiver(headers, stall, headers)
    found = subject.headers(list(Stream), 1.0)
    memory = {stream: np.zeros(BYTES, np.uint8) for stream in Stream}

    with pytest.raises(Stalled):
        subject.payloads(
            [(each, np.zeros(BYTES, np.uint8)) for each in found.values()], 1.0, memory
        )
    assert list(subject.headers(list(Stream), 1.0)) == list(Stream)

    assert sorted(set(link.cancelled)) == [0, 1]
    assert link.ahead[2] == []
