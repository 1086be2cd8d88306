"""A board that was lost: it is found again in the same stream, or an error says that it is not."""

import logging
import threading
import time

import pytest

from drivers.usb.connection import Connection
from drivers.usb.errors import Stalled, Unplugged
from drivers.usb.requests import Acknowledgement, Schedule
from pipeline.errors import DriverError
from tests.drivers.contract import command, read, started
from tests.drivers.usb.boards import board, played


def test_an_unplugged_board_is_found_again_in_the_same_stream_with_its_schedule() -> None:
    subject = board(virtual={"faults": [{"kind": "unplug", "exposure": 20, "seconds": 0.05}]})
    started(subject)
    seen = [read(subject) for _ in range(20)]
    header, window = seen[-1].header, (0, 0, 80, 48)
    subject.set_rois(command(header.stream, made_from=19, first=20, windows=[window] * 30))

    after = [read(subject) for _ in range(10)]

    subject.close()
    assert [e.header.seq for e in after] == list(range(20, 30))
    assert {e.header.stream for e in after} == {header.stream}
    assert {(e.roi.window, e.roi.command_seq) for e in after[1:]} == {(window, 19)}
    assert subject.summary()["link"]["outages"] == 1


@pytest.mark.parametrize("rows", [30, 961, 1500, 70_000])
def test_a_refused_schedule_is_counted_and_not_sent_to_a_board_that_is_back(
    monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    schedule, stalls = Connection.schedule, rows == 30

    def refuses(self: Connection, given: Schedule) -> Acknowledgement:
        if stalls and len(given.corners) == rows:
            raise Stalled("the board refused it")
        return schedule(self, given)

    monkeypatch.setattr(Connection, "schedule", refuses)
    subject = board(virtual={"faults": [{"kind": "unplug", "exposure": 20, "seconds": 0.05}]})
    started(subject)
    stream, window = read(subject).header.stream, (0, 0, 80, 48)
    seen = [read(subject) for _ in range(14)]
    subject.set_rois(command(stream, made_from=13, first=16, windows=[window] * 28))
    subject.set_rois(command(stream, made_from=14, first=17, windows=[(80, 48, 160, 96)] * rows))

    seen += [read(subject) for _ in range(15)]

    subject.close()
    assert subject.summary()["refused_commands"] == 1
    assert subject.summary()["link"]["outages"] == 1
    assert {(e.roi.window, e.roi.command_seq) for e in seen[-8:]} == {(window, 13)}


def test_a_board_that_is_back_and_refuses_the_schedule_goes_on_without_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    schedule, sent = Connection.schedule, []

    def refuses_again(self: Connection, given: Schedule) -> Acknowledgement:
        sent.append(given)
        if len(sent) > 1:
            raise Stalled("the board refused it")
        return schedule(self, given)

    monkeypatch.setattr(Connection, "schedule", refuses_again)
    subject = board(virtual={"faults": [{"kind": "unplug", "exposure": 20, "seconds": 0.05}]})
    started(subject)
    stream = read(subject).header.stream
    subject.set_rois(command(stream, made_from=0, first=16, windows=[(0, 0, 80, 48)] * 20))

    seen = [read(subject) for _ in range(28)]

    subject.close()
    assert len(sent) == 2
    assert (seen[-1].roi.command_seq, seen[-1].header.seq > 20) == (-1, True)
    assert subject.summary()["refused_commands"] == 1


def test_a_board_that_is_back_but_fails_to_start_is_opened_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    start, calls = Connection.start, []

    def refuses_once(self: Connection, *, triggered: bool) -> None:
        calls.append(triggered)
        if len(calls) == 2:  # the first after the outage
            raise Unplugged("gone again")
        start(self, triggered=triggered)

    monkeypatch.setattr(Connection, "start", refuses_once)
    fault = {"kind": "unplug", "exposure": 20, "seconds": 0.02}

    exposures = played(board(virtual={"faults": [fault]}))

    assert len(calls) == 3
    assert exposures[-1].header.seq > 20


def test_a_lost_board_is_waited_for_until_a_time_that_is_told() -> None:
    subject = board(
        virtual={"faults": [{"kind": "unplug", "exposure": 5, "seconds": 0.4}]}, reconnect_s=50.0
    )
    before_s, seen = time.monotonic(), [subject.absent_until_s]
    started(subject)
    seen.append(subject.absent_until_s)
    reader = threading.Thread(target=lambda: [read(subject) for _ in range(8)])
    reader.start()
    while reader.is_alive():
        seen.append(subject.absent_until_s)
        reader.join(0.01)
    seen.append(subject.absent_until_s)
    subject.close()

    until_s = max(seen)
    assert before_s + 50 < until_s < time.monotonic() + 50
    assert set(seen) == {0.0, until_s}
    assert seen[0] == seen[1] == seen[-1] == 0.0


def test_a_board_that_stays_away_is_an_error_after_the_limit() -> None:
    subject = board(
        virtual={"faults": [{"kind": "unplug", "exposure": 5, "seconds": 3600}]}, reconnect_s=0.2
    )

    with pytest.raises(DriverError, match=r"not back after .*no board is attached"):
        played(subject)


def test_what_is_said_when_a_board_is_lost_is_one_sentence_each(
    caplog: pytest.LogCaptureFixture,
) -> None:
    subject = board(virtual={"faults": [{"kind": "unplug", "exposure": 5, "seconds": 0.3}]})

    with caplog.at_level(logging.WARNING):
        played(subject)

    lost, found = (record.getMessage() for record in caplog.records)
    assert "looking for the board again" in lost
    assert "the board is back after" in found
