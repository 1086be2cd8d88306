"""The mode record: previews of the context, a burst by schedule, its download, previews again."""

import time
from typing import Any

import numpy as np
import pytest

from drivers.sensor import Exposure
from drivers.usb import DualStreamBoard
from drivers.usb.session import POLL_S
from drivers.virtual_board.profiles import PAPER_DELAY_FRAMES
from pipeline.errors import DriverError
from tests.drivers.contract import command, read, started
from tests.drivers.usb.boards import board

PREVIEW_INTERVAL = 4  # 30 exposures and 7.5 previews a second
BURST = 105


def prototype(
    *faults: dict[str, Any], profile: str = "paper-prototype", **settings: Any
) -> DualStreamBoard:
    """The paper's board, with a small sensor and an endless source."""
    values = {"mode": "record", "rate_hz": 30.0, **settings}
    virtual = {
        "profile": profile, "frames": 0, "source_options": {"length": None},
        "faults": faults,
    }  # fmt: skip
    return board(virtual=virtual, **values)


def recorded(subject: DualStreamBoard, last: Exposure, frames: int) -> list[Exposure]:
    """Send a plan of windows that move down, and return what follows."""
    header, first = last.header, last.header.seq + 2
    windows = [(0, 2 * (k % 50), 80, 2 * (k % 50) + 48) for k in range(frames)]
    subject.set_rois(command(header.stream, made_from=header.seq, first=first, windows=windows))
    return [read(subject) for _ in range(min(frames, BURST) + 1)]


def test_previews_come_at_their_rate_and_have_no_roi() -> None:
    subject = started(prototype())
    seen = [read(subject) for _ in range(5)]
    subject.close()

    assert [e.header.seq for e in seen] == [k * PREVIEW_INTERVAL for k in range(5)]
    assert {e.roi.window for e in seen} == {(0, 0, 0, 0)}
    assert {e.roi.pixels.size for e in seen} == {0}
    assert subject.summary()["frames"]["lost"] == 0


def test_a_preview_is_delivered_without_waiting_for_a_region() -> None:
    subject = started(prototype())
    read(subject)

    began = time.monotonic()
    for _ in range(10):
        read(subject)

    subject.close()
    assert time.monotonic() - began < 10 * POLL_S / 2


def test_a_plan_is_recorded_frame_by_frame_and_then_the_previews_go_on() -> None:
    subject = started(prototype())
    last = [read(subject) for _ in range(3)][-1]

    *burst, after = recorded(subject, last, frames=200)

    subject.close()
    first = last.header.seq + 2
    assert [e.header.seq for e in burst] == list(range(first, first + BURST))
    assert [e.roi.window[1] for e in burst] == [2 * (k % 50) for k in range(BURST)]
    assert {e.roi.command_seq for e in burst} == {last.header.seq}
    assert not after.roi.pixels.size
    assert after.header.seq % PREVIEW_INTERVAL == 0


def test_before_a_slow_host_a_plan_is_obeyed_60_frames_after_its_context() -> None:
    subject = started(prototype(profile="paper-prototype-slow-host"))
    last = read(subject).header
    windows = [(0, 2 * (k % 50), 80, 2 * (k % 50) + 48) for k in range(200)]

    subject.set_rois(command(last.stream, made_from=last.seq, first=last.seq + 1, windows=windows))
    seen = [read(subject) for _ in range(PAPER_DELAY_FRAMES // PREVIEW_INTERVAL + 1)]

    subject.close()
    first = next(e for e in seen if e.roi.pixels.size)
    assert first.header.seq == last.seq + PAPER_DELAY_FRAMES
    assert first.roi.window == windows[PAPER_DELAY_FRAMES - 1]
    assert not any(e.roi.pixels.size for e in seen[: seen.index(first)])


def test_a_plan_shorter_than_a_burst_is_recorded_as_far_as_it_goes() -> None:
    subject = started(prototype())

    *burst, after = recorded(subject, read(subject), frames=7)

    subject.close()
    assert len(burst) == 7
    assert all(e.roi.pixels.size for e in burst)
    assert not after.roi.pixels.size


def test_an_exposure_of_a_burst_that_fails_is_counted_as_lost() -> None:
    subject = started(prototype({"kind": "truncate", "exposure": 9}))

    burst = recorded(subject, read(subject), frames=20)

    subject.close()
    seqs = [e.header.seq for e in burst if e.roi.pixels.size]
    assert seqs == [seq for seq in range(2, 22) if seq != 9]
    assert subject.summary()["frames"]["lost"] == 1


def test_a_sensor_that_fails_in_a_burst_is_an_error_and_not_a_wait_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.usb.silence.SILENCE_S", 0.05)
    subject = started(prototype({"kind": "broken", "exposure": 9}))

    with pytest.raises(DriverError, match="the board reports a fault: sensor"):
        recorded(subject, read(subject), frames=20)
    subject.close()


def test_ten_bursts_follow_one_another_with_the_same_delay() -> None:
    subject = started(prototype())
    delays = []
    last = read(subject)
    for _ in range(10):
        *burst, last = recorded(subject, last, frames=20)
        delays.append(last.header.seq - burst[0].header.seq)
    subject.close()

    assert np.ptp(delays) <= PREVIEW_INTERVAL
    assert subject.summary()["commands"] == {"accepted": 10, "late": 0, "foreign": 0}
