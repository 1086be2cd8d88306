"""The reader of shirts on a drawn back, with the real recogniser."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("rapidocr")

from operators.reader import ShirtReader
from operators.reader.shirts import ShirtReaderSettings
from pipeline import Frame, Percept, SettingsError, Tracks
from pipeline.messages import Geometry
from pipeline.testing import header

FIELD = Geometry(width_px=1280, height_px=720, roi_width_px=320, roi_height_px=180)
PERSON = (500.0, 340.0, 540.0, 440.0)  # of the sensor; its back is 40 pixels wide
SHOWN = (400, 300, 720, 480)


def back(number: str = "23", left: int = 100) -> NDArray[np.uint8]:
    drawn = np.full((180, 320, 3), (70, 120, 50), np.uint8)
    cv2.rectangle(drawn, (left + 5, 58), (left + 35, 95), (30, 40, 150), -1)
    cv2.putText(drawn, number, (left + 9, 84), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (250, 250, 250), 2)
    return drawn


def roi(pixels: NDArray[np.uint8], seq: int = 0) -> Frame:
    return Frame(header=header(seq, geometry=FIELD), pixels=pixels, window=SHOWN)


def context(seq: int = 0) -> Frame:
    pixels = np.zeros((180, 320, 3), np.uint8)
    return Frame(header=header(seq, geometry=FIELD), pixels=pixels, window=(0, 0, 1280, 720))


def tracks(*boxes: tuple[float, float, float, float], seq: int = 0, speed: float = 0.0) -> Tracks:
    now = np.array(boxes, np.float32).reshape(-1, 1, 4)
    count, step = len(now), np.array([speed, 0, speed, 0], np.float32)
    return Tracks(
        header=header(seq, geometry=FIELD),
        ids=np.arange(count, dtype=np.int32),
        labels=np.zeros(count, np.int32),
        scores=np.ones(count, np.float32),
        boxes=np.concatenate([now - step, now], 1),
        visible=np.ones((count, 2), bool),
        features=np.zeros((count, 2, 4), np.float32),
        predicted=now + step,
        names=("player",),
    )


@pytest.fixture(scope="module")
def loaded() -> ShirtReader:
    made = ShirtReader(ShirtReaderSettings())
    made.open()
    return made


@pytest.fixture
def reader(loaded: ShirtReader) -> ShirtReader:
    loaded.on_stream(header(geometry=FIELD))
    return loaded


def read(reader: ShirtReader, pixels: NDArray[np.uint8], seq: int = 0) -> Percept:
    return reader.on_context_roi(context(seq), roi(pixels, seq))


def test_the_number_on_a_back_is_read_where_it_is(reader: ShirtReader) -> None:
    reader.on_tracks(tracks(PERSON))

    percept = read(reader, back())

    assert percept.texts == ("23",)
    left, top, right, low = percept.boxes[0].tolist()
    assert PERSON[0] < left < right < PERSON[2]
    assert PERSON[1] + 20 < top < low < PERSON[1] + 50


def test_what_is_no_number_is_not_read(reader: ShirtReader) -> None:
    reader.on_tracks(tracks(PERSON))

    assert read(reader, back("AB")).texts == ()
    assert read(reader, back("")).texts == ()


def test_only_what_this_exposure_shows_is_answered(reader: ShirtReader) -> None:
    reader.on_tracks(tracks(PERSON))

    first, second = read(reader, back()), read(reader, back(""), 1)

    assert first.texts == ("23",)
    assert second.texts == ()


def test_a_person_is_looked_for_where_it_will_be(reader: ShirtReader) -> None:
    reader.on_tracks(tracks((470, 340, 510, 440), speed=30.0))

    assert read(reader, back(), 1).texts == ("23",)


def test_tracks_newer_than_the_picture_tell_where_a_person_was(reader: ShirtReader) -> None:
    reader.on_tracks(tracks((530, 340, 570, 440), seq=6, speed=30.0))

    assert read(reader, back(), 5).texts == ("23",)


def test_before_the_history_of_the_tracks_nothing_is_read(reader: ShirtReader) -> None:
    reader.on_tracks(tracks(PERSON, seq=7))

    assert read(reader, back(), 5).texts == ()


@pytest.mark.parametrize(
    "box", [(900, 340, 940, 440), (500, 340, 504, 350)], ids=["outside", "too small"]
)
def test_persons_outside_the_roi_and_tiny_ones_are_left_out(
    reader: ShirtReader, box: tuple[float, float, float, float]
) -> None:
    reader.on_tracks(tracks(box))

    assert read(reader, back()).texts == ()


def test_a_person_who_is_read_twice_is_two_readings_and_no_two_texts() -> None:
    made = ShirtReader(ShirtReaderSettings())
    made.open()
    made.on_tracks(tracks(PERSON))

    read(made, back())
    read(made, back())

    assert made.summary() == {"frames": 2, "readings": 2}
    assert made.headline() == "2 readings"


def test_ids_of_readings_begin_again_before_they_are_too_large(reader: ShirtReader) -> None:
    reader.restore(replace(reader.state(), next_id=2**31 - 1))
    reader.on_tracks(tracks(PERSON))

    assert read(reader, back()).ids.tolist() == [1]


def test_without_tracks_nothing_is_read(reader: ShirtReader) -> None:
    assert read(reader, back()).texts == ()


@pytest.mark.parametrize(
    ("given", "about"), [({"part": (0.5, 0.1, 0.4, 0.9)}, "part"), ({"pattern": "["}, "pattern")]
)
def test_settings_that_cannot_be_are_refused(given: dict[str, object], about: str) -> None:
    with pytest.raises(SettingsError, match=f"{about}: expected"):
        ShirtReaderSettings(**given)  # type: ignore[arg-type]
