"""The share of legible texts that were transcribed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from operators.transcribed import (
    ILLEGIBLE,
    Tally,
    Transcribed,
    TranscribedSettings,
    edits,
    matches,
)
from pipeline import Header, Percept
from pipeline.contract import HEADLINE
from pipeline.errors import MessageError
from pipeline.messages import Truth

BOX, AWAY = (100.0, 50.0, 160.0, 70.0), (400.0, 50.0, 460.0, 70.0)
Row = tuple[int, str, tuple[float, float, float, float]]


def truth(*rows: Row, seq: int = 0) -> Truth:
    return Truth(
        header=Header(stream="s", seq=seq, stamp_ns=seq),
        boxes=np.array([row[2] for row in rows], np.float32).reshape(-1, 4),
        ids=np.array([row[0] for row in rows], np.int32),
        labels=tuple(row[1] for row in rows),
        visibility=np.ones(len(rows), np.float32),
    )


def percept(*rows: tuple[str, tuple[float, float, float, float]], seq: int = 0) -> Percept:
    return Percept(
        header=Header(stream="s", seq=seq, stamp_ns=seq),
        boxes=np.array([row[1] for row in rows], np.float32).reshape(-1, 4),
        ids=np.arange(len(rows), dtype=np.int32),
        scores=np.ones(len(rows), np.float32),
        texts=tuple(row[0] for row in rows),
    )


def tallied(*frames: tuple[Percept, Truth]) -> dict[str, int]:
    tally = Tally()
    for each in frames:
        tally.add(*each)
    return tally.counts()


def test_a_text_read_at_its_place_counts_once() -> None:
    frame = percept(("bakery", BOX)), truth((1, "BAKERY", BOX))

    assert tallied(frame, frame) == {"legible": 1, "read": 1, "nearly": 1}


def test_the_right_text_at_another_place_does_not_count() -> None:
    assert tallied((percept(("BAKERY", AWAY)), truth((1, "BAKERY", BOX))))["read"] == 0


def test_a_reading_with_one_wrong_letter_counts_as_nearly() -> None:
    counts = tallied((percept(("BAKFRY", BOX)), truth((1, "BAKERY", BOX))))

    assert (counts["read"], counts["nearly"]) == (0, 1)


def test_what_is_never_legible_is_not_asked_for() -> None:
    assert tallied((percept(("X", BOX)), truth((1, ILLEGIBLE, BOX))))["legible"] == 0


def test_a_reading_before_the_text_counts_as_legible_is_kept_for_it() -> None:
    early = percept(("HOTEL", BOX)), truth((1, ILLEGIBLE, BOX))
    later = percept(seq=1), truth((1, "HOTEL", BOX), seq=1)

    assert tallied(early, later)["read"] == 1


def test_a_text_that_grows_illegible_again_may_still_be_read() -> None:
    legible = percept(), truth((1, "HOTEL", BOX))
    after = percept(("HOTEL", BOX), seq=1), truth((1, ILLEGIBLE, BOX), seq=1)

    assert tallied(legible, after)["read"] == 1


def test_the_wait_is_from_legible_to_read() -> None:
    tally = Tally()
    tally.add(percept(seq=3), truth((1, "HOTEL", BOX), seq=3))
    tally.add(percept(("HOTEL", BOX), seq=7), truth((1, "HOTEL", BOX), seq=7))

    assert tally.waits() == [4]


def test_one_reading_is_at_one_place_only() -> None:
    near = (105.0, 50.0, 165.0, 70.0)

    assert matches(np.array([BOX], np.float32), np.array([BOX, near], np.float32)) == [(0, 0)]


@pytest.mark.parametrize(
    ("label", "sentence"),
    [
        ("", "texts that were read: not known, the source has no truth"),
        (ILLEGIBLE, "texts that were read: not known, the truth has no legible one"),
        ("BAKERY", "read 1 of 1 legible texts"),
    ],
)
def test_a_clip_without_truth_is_told_and_not_counted_as_nothing_read(
    label: str, sentence: str
) -> None:
    operator = Transcribed(TranscribedSettings())
    operator.open()

    if label:
        operator.on_percept_truth(percept(("bakery", BOX)), truth((1, label, BOX)))

    assert operator.summary()[HEADLINE] == sentence


def test_labels_that_do_not_fit_the_boxes_are_refused() -> None:
    wrong = Truth(
        header=Header(stream="s", seq=0, stamp_ns=0),
        boxes=np.array([BOX], np.float32), ids=np.array([1], np.int32), labels=(),
        visibility=np.ones(1, np.float32),
    )  # fmt: skip

    with pytest.raises(MessageError, match="expected one for each box"):
        Tally().add(percept(), wrong)


@given(st.text(alphabet="ABC", max_size=6), st.text(alphabet="ABC", max_size=6))
def test_edits_are_a_distance(a: str, b: str) -> None:
    assert edits(a, b) == edits(b, a)
    assert (edits(a, b) == 0) == (a == b)
    assert edits(a, a + "C") == 1
