"""The thread that keeps the newest frame: what is skipped, lost, reopened and given up."""

import logging
import threading
from collections.abc import Iterator

import pytest

from drivers.camera import Picture
from drivers.cameras.link import LinkSettings
from drivers.cameras.newest import NewestFrame
from pipeline.errors import DriverError, SettingsError
from tests.drivers.cameras.scripted_connection import Step, scripted

BACKOFF_S = (0.01, 0.02)
PATIENT = LinkSettings(open_timeout_s=60.0, read_timeout_s=60.0, outage_s=60.0, backoff_s=BACKOFF_S)


def opened(*scripts: object, limits: LinkSettings = PATIENT) -> NewestFrame:
    connect, _ = scripted(*scripts)  # type: ignore[arg-type]
    subject = NewestFrame(connect, limits, name="camera")
    subject.open()
    return subject


def next_of(subject: NewestFrame) -> Picture:
    found = subject.read(30.0)
    assert found is not None
    return found


def shown(picture: Picture) -> int:
    return int(picture.pixels[0, 0, 0])


def forever(step: Step) -> Iterator[Step]:
    while True:
        yield step


def test_the_newest_frame_wins_and_the_others_are_counted() -> None:
    read_first, sent = threading.Event(), threading.Event()

    def script() -> Iterator[Step]:
        yield 1
        yield read_first
        yield from (2, 3, 4)
        sent.set()
        yield from forever("quiet")

    subject = opened(script)
    first = next_of(subject)
    assert (shown(first), first.skipped) == (1, 0)
    read_first.set()
    assert sent.wait(30)
    newest = next_of(subject)
    subject.close()

    assert (shown(newest), newest.skipped) == (4, 2)
    assert newest.stamp_ns > first.stamp_ns
    assert subject.history.summary()["frames"] == {
        "arrived": 4, "delivered": 2, "unread": 2, "damaged": 0,
    }  # fmt: skip


def test_a_picture_is_valid_until_the_next_read() -> None:
    read_first, sent = threading.Event(), threading.Event()

    def script() -> Iterator[Step]:
        yield 1
        yield read_first
        yield from (2, 3, 4, 5, 6)
        sent.set()
        yield from forever("quiet")

    subject = opened(script)
    held = next_of(subject)
    read_first.set()
    assert sent.wait(30)

    assert shown(held) == 1
    assert shown(next_of(subject)) == 6
    subject.close()


def test_close_ends_an_open_of_another_thread() -> None:
    connect, _ = scripted(lambda: forever("quiet"))
    limits = LinkSettings(open_timeout_s=60.0)
    subject = NewestFrame(connect, limits, name="camera")
    said: list[str] = []

    def opening() -> None:
        try:
            subject.open()
        except DriverError as error:
            said.append(str(error))

    opener = threading.Thread(target=opening)
    opener.start()
    while not subject.history.attempts:
        opener.join(0.01)
    subject.close()
    opener.join(30)

    assert said == ["camera: closed before its first frame"]


def test_damaged_frames_are_skipped_and_counted() -> None:
    def script() -> Iterator[Step]:
        yield from ("damaged", "damaged", 1)
        yield from forever("quiet")

    subject = opened(script)
    first = next_of(subject)
    subject.close()

    assert (shown(first), first.skipped) == (1, 2)
    assert subject.history.summary()["frames"]["damaged"] == 2


def test_a_lost_camera_is_opened_again_and_its_outage_told_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    read_first = threading.Event()

    def before() -> Iterator[Step]:
        yield 1
        yield read_first
        yield "the stream ended"

    def after() -> Iterator[Step]:
        yield 2
        yield from forever("quiet")

    with caplog.at_level(logging.WARNING):
        subject = opened(before, "the host refuses", "the host refuses", after)
        next_of(subject)
        read_first.set()
        second = next_of(subject)
        subject.close()

    told = subject.history.summary()
    assert (shown(second), told["reconnects"], told["attempts"]) == (2, 1, 4)
    (outage,) = told["outages"]["newest"]
    assert (outage["reason"], outage["attempts"]) == ("the stream ended", 3)
    assert 0 < outage["lasted_s"] == told["outages"]["longest_s"]
    assert [r.getMessage().split(" after")[0] for r in caplog.records] == [
        "camera: lost, reconnecting: the stream ended",
        "camera: back",
    ]


def test_a_silent_camera_is_opened_again() -> None:
    def silent() -> Iterator[Step]:
        yield 1
        yield from forever("quiet")

    def after() -> Iterator[Step]:
        yield 2
        yield from forever("quiet")

    limits = LinkSettings(read_timeout_s=0.2, outage_s=60.0, backoff_s=BACKOFF_S)
    subject = opened(silent, after, limits=limits)
    assert [shown(next_of(subject)), shown(next_of(subject))] == [1, 2]
    subject.close()

    (outage,) = subject.history.summary()["outages"]["newest"]
    assert outage["reason"] == "it is open but sends no frame"


def test_a_lost_camera_is_waited_for_until_a_time_that_is_told() -> None:
    read_first, back = threading.Event(), threading.Event()

    def before() -> Iterator[Step]:
        yield 1
        yield read_first
        yield "the stream ended"

    def after() -> Iterator[Step]:
        yield back
        yield 2
        yield from forever("quiet")

    subject = opened(before, after)
    first = next_of(subject)
    told = [subject.absent_until_s]
    read_first.set()
    while not subject.absent_until_s:
        subject.read(0.01)
    told.append(subject.absent_until_s)
    back.set()
    next_of(subject)
    told.append(subject.absent_until_s)
    subject.close()

    assert told == [0.0, first.stamp_ns / 1e9 + PATIENT.outage_s, 0.0]
    assert subject.absent_until_s == 0.0


def test_a_camera_that_stays_away_is_given_up_with_the_reason() -> None:
    def script() -> Iterator[Step]:
        yield 1
        yield "unplugged"

    subject = opened(script, limits=LinkSettings(outage_s=1.0, backoff_s=BACKOFF_S))
    next_of(subject)
    for _ in range(2):
        with pytest.raises(
            DriverError, match=r"no frame for \d+\.\d s, more than outage_s, 1: it is"
        ):
            subject.read(30.0)
    subject.close()

    told = subject.history.summary()
    assert told["outages"]["count"] == 1
    assert told["outages"]["newest"][0]["reason"] == "unplugged"
    assert told["attempts"] > 3  # the pauses have a longest


def test_a_camera_that_is_not_there_at_first_is_an_error_at_once() -> None:
    with pytest.raises(DriverError, match="camera: no such device"):
        opened("no such device")


def test_opening_can_wait_for_a_camera() -> None:
    def script() -> Iterator[Step]:
        yield 7
        yield from forever("quiet")

    limits = LinkSettings(open_wait_s=60.0, backoff_s=(0.01, 0.01))
    subject = opened("not yet", "not yet", script, limits=limits)
    first = next_of(subject)
    subject.close()

    assert shown(first) == 7
    assert subject.history.summary()["outages"]["count"] == 0


def test_a_camera_without_a_first_frame_is_an_error() -> None:
    limits = LinkSettings(open_timeout_s=0.1)
    with pytest.raises(DriverError, match="camera: it is open but sends no frame"):
        opened(lambda: forever("quiet"), limits=limits)
    with pytest.raises(DriverError, match="camera: it is open but sends only damaged frames"):
        opened(lambda: forever("damaged"), limits=limits)


def test_another_size_in_the_middle_is_an_error_and_no_reason_to_try_again() -> None:
    def script() -> Iterator[Step]:
        yield from (1, (8, 4), 2)

    connect, made = scripted(script)
    subject = NewestFrame(connect, PATIENT, name="camera")
    subject.open()
    next_of(subject)
    for _ in range(2):
        with pytest.raises(DriverError, match="expected frames of 6x4 as at the start, got 8x4"):
            subject.read(30.0)
    subject.close()

    assert [connection.closed for connection in made] == [True]


def test_close_ends_a_read_of_another_thread_and_releases_the_device() -> None:
    def script() -> Iterator[Step]:
        yield 1
        yield from forever("quiet")

    connect, made = scripted(script)
    subject = NewestFrame(connect, PATIENT, name="camera")
    subject.open()
    next_of(subject)
    answers: list[object] = []
    reader = threading.Thread(target=lambda: answers.append(subject.read(30.0)))
    reader.start()
    subject.close()
    reader.join(30)

    assert answers == [None]
    assert made[0].closed
    assert subject.read(1.0) is None


def test_code_that_breaks_in_the_thread_is_an_error_for_the_reader() -> None:
    def script() -> Iterator[Step]:
        yield 1
        raise ZeroDivisionError

    subject = opened(script)
    next_of(subject)
    with pytest.raises(DriverError, match="camera: reading it broke: ZeroDivisionError"):
        subject.read(30.0)
    subject.close()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"open_timeout_s": 0.0}, "open_timeout_s: expected 0.05 to 3600, got 0"),
        ({"outage_s": 1e9}, "outage_s: expected 0.05 to 3600, got 1e+09"),
        ({"open_wait_s": -1.0}, "open_wait_s: expected 0 to 3600, got -1"),
        ({"backoff_s": (2.0, 1.0)}, "backoff_s: expected a first pause of at least 0.01"),
        ({"backoff_s": (0.0, 1.0)}, "backoff_s: expected a first pause of at least 0.01"),
    ],
)
def test_wrong_limits_are_refused(settings: dict[str, object], said: str) -> None:
    with pytest.raises(SettingsError) as error:
        LinkSettings(**settings)  # type: ignore[arg-type]

    assert said in str(error.value)
