"""Parts of the evaluation of the text task that know the truth."""

from typing import Any

import numpy as np

from bench.reading.known import NothingToSet, TrueDetections, TrueReader
from bench.reading.oracle import Oracle
from drivers.source import Annotations
from operators.transcribed import ILLEGIBLE
from pipeline import Frame, Header, Percept, Tracks
from pipeline.messages import Geometry

GEOMETRY = Geometry(width_px=1280, height_px=720, roi_width_px=320, roi_height_px=180)


def oracle(*rows: tuple[int, str, tuple[float, float, float, float]]) -> Oracle:
    made = Oracle(NothingToSet())
    made.open()
    made.truth_of = lambda index: truth(*rows)
    return made


def truth(*rows: tuple[int, str, tuple[float, float, float, float]]) -> Annotations:
    return Annotations(
        boxes=np.array([row[2] for row in rows], np.float32).reshape(-1, 4),
        ids=np.array([row[0] for row in rows], np.int32),
        labels=tuple(row[1] for row in rows),
        visibility=np.ones(len(rows), np.float32),
    )


def header(seq: int = 0) -> Header:
    return Header(stream="s", seq=seq, stamp_ns=seq, geometry=GEOMETRY)


def no_tracks(seq: int = 0) -> Tracks:
    values: dict[str, Any] = {
        "ids": np.zeros(0, np.int32), "labels": np.zeros(0, np.int32),
        "scores": np.zeros(0, np.float32), "boxes": np.zeros((0, 1, 4), np.float32),
        "visible": np.zeros((0, 1), bool), "features": np.zeros((0, 1, 1), np.float32),
        "predicted": np.zeros((0, 1, 4), np.float32),
    }  # fmt: skip
    return Tracks(header=header(seq), **values)


NEAR, FAR, ALONE = (100, 100, 160, 115), (200, 120, 260, 135), (900, 400, 960, 415)


def test_the_oracle_looks_where_most_texts_are_unread() -> None:
    policy = oracle((1, "A", NEAR), (2, "B", FAR), (3, "C", ALONE))

    box = policy.on_tracks(no_tracks()).boxes[0]

    assert box[0] < 300


def test_the_oracle_leaves_what_is_read_and_what_nobody_can_read() -> None:
    policy = oracle((1, "A", NEAR), (2, ILLEGIBLE, FAR), (3, "C", ALONE))
    policy.on_percept(
        Percept(
            header=header(), boxes=np.array([NEAR], np.float32), ids=np.array([9], np.int32),
            scores=np.ones(1, np.float32), texts=("a",),
        )
    )  # fmt: skip

    assert policy.on_tracks(no_tracks()).boxes[0].tolist() == list(ALONE)


def test_the_oracle_gives_up_on_a_text_that_is_never_read() -> None:
    policy = oracle((1, "A", NEAR), (2, "B", ALONE))
    looks = [policy.on_tracks(no_tracks(seq)).boxes[0, 0] for seq in range(8)]

    assert looks.count(100) == 3
    assert looks.count(900) == 3


def test_a_true_reader_reads_what_the_roi_shows_whole_and_nothing_else() -> None:
    reader = TrueReader(NothingToSet())
    reader.open()
    reader.truth_of = lambda index: truth((1, "A", NEAR), (2, ILLEGIBLE, FAR), (3, "C", ALONE))
    pixels = np.zeros((180, 320, 3), np.uint8)
    roi = Frame(header=header(), pixels=pixels, window=(50, 50, 370, 230))

    percept = reader.on_context_roi(roi, roi)

    assert percept.texts == ("A",)
    assert percept.ids.tolist() == [1]


def test_true_detections_are_all_texts_that_are_seen() -> None:
    finder = TrueDetections(NothingToSet())
    finder.truth_of = lambda index: truth((1, "A", NEAR), (2, ILLEGIBLE, FAR))

    found = finder.on_frame(Frame(header=header(), pixels=np.zeros((180, 320, 3), np.uint8)))

    assert found.boxes.tolist() == [list(NEAR), list(FAR)]
    assert found.names == ("text",)


def test_past_the_end_nothing_is_known() -> None:
    finder, reader = TrueDetections(NothingToSet()), TrueReader(NothingToSet())
    reader.open()
    finder.truth_of = reader.truth_of = lambda index: None
    frame = Frame(header=header(), pixels=np.zeros((180, 320, 3), np.uint8))

    assert not len(finder.on_frame(frame).boxes)
    assert reader.on_context_roi(frame, frame).texts == ()
