"""The USB board: the contract of a sensor, and what the driver does when something fails."""

import re
import time
from typing import Any

import numpy as np
import pytest

from drivers.sensor import Mode
from drivers.usb.connection import Connection
from drivers.usb.errors import Unplugged
from drivers.virtual_board.faults import Fault
from pipeline.errors import DriverError, FoveaError, PoolExhausted, SettingsError
from tests.drivers.contract import (
    answers_to_a_stop,
    check_sensor,
    read,
    refuse,
    started,
)
from tests.drivers.moving_square import MovingSquare
from tests.drivers.usb.boards import SQUARE, VIRTUAL, backend, board, played

LAST = 39  # exposure of the virtual source


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"pixel_format": "bayer_rggb8"},
        {"pixel_format": "bayer_rggb12p"},
        {"pixel_format": "bayer_rggb16"},
        {"payload_crc": True},
        {"roi_px": (160, 96)},
        {"in_flight": 1},
    ],
)
def test_it_keeps_the_contract_of_a_sensor(settings: dict[str, Any]) -> None:
    before = MovingSquare.open_sources

    check_sensor(lambda: board(**settings))

    assert MovingSquare.open_sources == before


def test_pixels_are_those_that_the_window_shows() -> None:
    subject = started(board())
    exposure = read(subject)
    subject.close()

    left, top, right, bottom = exposure.roi.window
    picture = MovingSquare(length=None).picture(0)
    assert np.array_equal(exposure.roi.pixels, picture[top:bottom, left:right])


def test_a_window_of_twice_the_size_is_read_binned() -> None:
    subject = started(board(roi_px=(160, 96)))
    exposure, can = read(subject), subject.capabilities()
    subject.close()

    left, top, right, bottom = exposure.roi.window
    assert (right - left, bottom - top) == (160, 96)
    assert exposure.roi.pixels.shape == (48, 80, 3)
    assert can.roi_binning == 2


def test_in_realtime_exposures_come_at_the_rate_with_stamps_of_this_clock() -> None:
    begun_ns = time.monotonic_ns()

    exposures = played(board(rate_hz=200.0), realtime=True)

    stamps = np.array([e.header.stamp_ns for e in exposures])
    assert begun_ns < stamps[0] < stamps[-1] <= time.monotonic_ns()
    frames = np.diff([e.header.seq for e in exposures])
    assert np.allclose(np.diff(stamps) / frames, 5e6, atol=2e6)


def test_a_stop_ends_a_read_that_waits() -> None:
    subject = board(virtual={"frames": 0, "source_options": {"length": None}}, rate_hz=0.2)
    started(subject, realtime=True)

    assert answers_to_a_stop(subject) == [None]


FAULTS = [  # what fails, how the loss is counted, what is said of it
    ("stall", "stall", r"the halt is cleared"),
    ("truncate", "incomplete", r"(roi|context) of exposure 20: expected \d+ bytes, got \d+"),
    ("corrupt_header", "header", r"(roi|context): looking for the next frame: "),
    ("corrupt_payload", "checksum", r"(roi|context) of exposure 20: expected the checksum 0x"),
    ("overflow", "overflow", r"exposure 20: "),
    ("skip", "unpaired", r"exposure 20: only its (roi|context) has come"),
]


@pytest.mark.parametrize("stream", ["context", "roi"])
@pytest.mark.parametrize(("kind", "reason", "said"), FAULTS, ids=[kind for kind, *_ in FAULTS])
def test_a_frame_that_fails_is_counted_and_reported_and_the_next_one_is_whole(
    kind: str, reason: str, said: str, stream: str, caplog: pytest.LogCaptureFixture
) -> None:
    fault = {"kind": kind, "exposure": 20, "stream": stream}
    subject = board(virtual={"faults": [fault]}, payload_crc=True)

    exposures = played(subject)

    summary = subject.summary()
    seqs = [e.header.seq for e in exposures]
    assert seqs == [k for k in range(LAST + 1) if k != 20]
    assert summary["frames"] == {"exposed": LAST, "lost": 1, "overrun": 0}
    assert summary["losses"].get(reason, 0) >= 1, summary
    assert any(re.search(said, text) for text in caplog.messages), caplog.messages
    whole = played(board())
    for exposure in exposures:
        other = whole[exposure.header.seq]
        assert np.array_equal(exposure.context.pixels, other.context.pixels)
        assert np.array_equal(exposure.roi.pixels, other.roi.pixels)


@pytest.mark.parametrize("kind", [kind for kind, *_ in FAULTS])
def test_after_a_failure_nothing_that_was_read_ahead_is_taken_for_a_frame(kind: str) -> None:
    faults = [{"kind": kind, "exposure": 10, "stream": "roi"}]
    subject = board(virtual={"faults": faults}, payload_crc=True)

    exposures = played(subject, realtime=True)

    assert subject.summary()["link"]["read_ahead"] > 0
    whole = played(board())
    for exposure in exposures:
        other = whole[exposure.header.seq]
        assert np.array_equal(exposure.context.pixels, other.context.pixels)
        assert np.array_equal(exposure.roi.pixels, other.roi.pixels)


def test_a_second_stall_at_once_resets_the_board() -> None:
    faults = [{"kind": "stall", "exposure": k} for k in (20, 22)]
    subject = board(virtual={"faults": faults})

    exposures = played(subject)

    link = subject.summary()["link"]
    counted = {name: link[name] for name in ("outages", "stalls", "resets", "silences")}
    assert counted == {"outages": 1, "stalls": 2, "resets": 1, "silences": 0}
    assert len(exposures) > 30


def test_a_broken_sensor_is_an_error_and_not_a_wait_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.usb.silence.SILENCE_S", 0.05)
    faults = [{"kind": "broken", "exposure": 5}]
    subject = board(virtual={"faults": faults, "source_options": {"length": None}, "frames": 0})

    with pytest.raises(DriverError, match="the board reports a fault: sensor"):
        played(subject, realtime=True)


def test_silence_is_asked_about_and_ends_in_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.usb.silence.SILENCE_S", 0.05)
    faults = [{"kind": "silence", "exposure": 5, "seconds": 3600}]
    subject = board(virtual={"faults": faults, "source_options": {"length": None}, "frames": 0})

    with pytest.raises(DriverError, match="sends nothing, and says that it is live"):
        played(subject, realtime=True)


def test_a_slow_reader_loses_the_oldest_frames_and_counts_them() -> None:
    subject = board(virtual={"frames": 0, "source_options": {"length": None}}, rate_hz=1000.0)
    started(subject, realtime=True)
    read(subject)
    time.sleep(0.1)  # a hundred exposures, of which the board keeps four
    late = [read(subject) for _ in range(6)]
    subject.close()

    summary = subject.summary()
    assert summary["frames"]["lost"] >= 80
    assert summary["losses"]["dropped"] >= 80
    assert late[-1].header.seq >= 90


def test_an_exposure_without_memory_is_read_away() -> None:
    subject = started(board())
    for _ in range(5):
        with pytest.raises(PoolExhausted):
            subject.read(refuse)
    exposure = read(subject)
    subject.close()

    assert exposure.header.seq == 5
    assert subject.summary()["frames"] == {"exposed": 1, "lost": 0, "overrun": 5}


def test_more_than_the_link_carries_is_refused_with_the_figures() -> None:
    subject = board(link_bytes_per_s=1_000_000)

    with pytest.raises(SettingsError) as refusal:
        subject.open(realtime=False)

    assert str(refusal.value) == (
        "rate_hz: rgb8 at 100 Hz needs 2 MB/s, the link carries 1: at most 43.4 Hz"
    )


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"mode": "record"}, "mode: expected live, as the board can, got record"),
        ({"roi_px": (81, 48)}, "roi_px: expected 80x48, 160x96, got 81x48"),
        ({"rate_hz": 1e4}, "rate_hz: expected 0.1 to 1000, got 10000"),
        (
            {"pixel_format": "grey8"},
            "pixel_format: expected rgb8, bayer_rggb8, bayer_rggb10, bayer_rggb10p, bayer_rggb12, "
            "bayer_rggb12p, bayer_rggb14, bayer_rggb16, got 'grey8'",
        ),
        ({"serial": "V9"}, "serial: no board V9; attached: V0001"),
        ({"burst_frames": 3}, "burst_frames: expected at most 0, got 3"),
    ],
)
def test_what_the_board_cannot_do_is_refused_in_one_sentence(
    settings: dict[str, Any], said: str
) -> None:
    with pytest.raises(FoveaError) as refusal:
        board(**settings).open(realtime=False)

    assert str(refusal.value).startswith(said)


@pytest.mark.parametrize(
    "settings",
    [
        {"rate_hz": -1.0}, {"rate_hz": float("nan")}, {"in_flight": 0}, {"in_flight": 99},
        {"reconnect_s": -1.0}, {"burst_frames": -1}, {"roi_px": (-1, 2)}, {"pixel_format": "x"},
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused_before_anything_is_opened(
    settings: dict[str, Any],
) -> None:
    with pytest.raises(SettingsError, match=next(iter(settings))):
        board(**settings)


def test_a_mode_is_changed_before_the_start() -> None:
    subject = board()
    subject.open(realtime=False)
    subject.configure(Mode(rate_hz=50.0, roi_px=(160, 96), pixel_format="bayer_rggb8"))
    subject.start()
    exposure = read(subject)
    with pytest.raises(SettingsError):
        subject.configure(Mode(roi_px=(3, 3)))
    subject.close()

    assert exposure.roi.pixel_format == "bayer_rggb8"
    assert exposure.roi.pixels.shape == (48, 80)


def test_a_board_in_use_is_said_to_be_in_use() -> None:
    bus = backend()
    first = Connection(bus, serial="", in_flight=1)

    with pytest.raises(DriverError, match="in use by another process"):
        Connection(bus, serial="", in_flight=1)

    first.close()
    Connection(bus, serial="", in_flight=1).close()


def test_no_board_is_one_sentence() -> None:
    bus = backend()
    bus.board.faults.add(Fault(kind="unplug", exposure=0, seconds=3600))
    connection = Connection(bus, serial="", in_flight=1)
    connection.start(triggered=True)
    connection.trigger()
    with pytest.raises(Unplugged):
        connection.status()

    with pytest.raises(DriverError, match="no board is attached"):
        Connection(bus, serial="", in_flight=1)


def test_a_recording_of_another_size_than_the_sensor_is_refused() -> None:
    subject = board(virtual={**VIRTUAL, "scene": "", "source": SQUARE, "size_px": (640, 384)})
    subject.open(realtime=False)

    with pytest.raises(DriverError, match="expected a source of 640x384, got 320x192"):
        subject.start()

    subject.close()
