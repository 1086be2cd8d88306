"""Names of tracks: voted for by readings, unique by shirt, kept, and passed on."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.name_tracks import NameTracks
from operators.name_tracks.name_tracks import NameTracksSettings
from operators.name_tracks.persons import Person, found_again, settled
from pipeline import Frame, Percept, SettingsError, Tracks
from pipeline.errors import MessageError
from pipeline.messages import Message
from pipeline.testing import drive, header

Box = tuple[float, float, float, float]
HERE, THERE = (100.0, 100.0, 140.0, 200.0), (400.0, 100.0, 440.0, 200.0)
RED, BLUE = (200, 30, 40), (30, 60, 170)


def tracks(seq: int, boxes: Mapping[int, Box], speed: float = 0.0) -> Tracks:
    count = len(boxes)
    now = np.array([*boxes.values()], np.float32).reshape(count, 1, 4)
    step = np.array([speed, 0, speed, 0], np.float32)
    return Tracks(
        header=header(seq),
        ids=np.array([*boxes], np.int32),
        labels=np.zeros(count, np.int32),
        scores=np.ones(count, np.float32),
        boxes=np.concatenate([now - step, now], 1),
        visible=np.ones((count, 2), bool),
        features=np.zeros((count, 2, 4), np.float32),
        predicted=np.concatenate([now + step, now + 2 * step], 1),
        names=("player",),
    )


def read(seq: int, *texts: tuple[str, float, Box]) -> dict[str, Message]:
    """Return readings, each in the middle of the upper part of a person's box."""
    boxes = [(b[0] + 10, b[1] + 30, b[2] - 10, b[1] + 45) for _, _, b in texts]
    return {
        "percept": Percept(
            header=header(seq),
            boxes=np.array(boxes, np.float32).reshape(-1, 4),
            ids=np.arange(len(texts), dtype=np.int32),
            scores=np.array([score for _, score, _ in texts], np.float32),
            texts=tuple(text for text, _, _ in texts),
        )
    }


def roi(seq: int, *shirts: tuple[Box, tuple[int, int, int]]) -> dict[str, Message]:
    pixels: NDArray[np.uint8] = np.full((300, 600, 3), 90, np.uint8)
    for (x0, y0, x1, y1), colour in shirts:
        pixels[int(y0) : int(y1), int(x0) : int(x1)] = colour
    return {"roi": Frame(header=header(seq), pixels=pixels, window=(0, 0, 600, 300))}


def played(messages: Sequence[Any], **settings: Any) -> Percept:
    """Return the last answer."""
    found = [each for each in drive(NameTracks, messages, settings) if each is not None]
    assert isinstance(found[-1], Percept)
    return found[-1]


def known(seq: int = 2, text: str = "23", box: Box = HERE, id_: int = 7) -> list[Any]:
    """Return messages after which a track has a name."""
    both = [(read(k, (text, 1.0, box)), tracks(k, {id_: box})) for k in range(seq)]
    return [message for pair in both for message in pair]


def test_two_sure_readings_name_the_track_that_has_them() -> None:
    percept = played(known())

    assert percept.texts == ("23",)
    assert percept.ids.tolist() == [7]
    assert percept.boxes.tolist() == [list(HERE)]
    assert percept.scores.tolist() == [1.0]


def test_a_text_of_spaces_is_no_reading() -> None:
    assert played(known(text="  ")).texts == ()
    assert played([*known(), *known(text=" ")]).texts == ("23",)


def test_one_reading_is_no_name_yet() -> None:
    assert played(known(1)).texts == ()


def test_the_name_stays_while_nothing_is_read() -> None:
    turned = [tracks(seq, {7: HERE}) for seq in range(2, 200)]

    assert played([*known(), *turned]).texts == ("23",)


def test_readings_that_conflict_lower_the_score_and_the_majority_wins() -> None:
    more = [read(2, ("28", 0.9, HERE)), tracks(2, {7: HERE})]

    percept = played([*known(), *more])

    assert percept.texts == ("23",)
    assert 0.6 < percept.scores[0] < 0.8


def test_enough_new_readings_outvote_the_old_ones() -> None:
    old = known(50)
    new = [m for k in range(50, 62) for m in (read(k, ("9", 1.0, HERE)), tracks(k, {7: HERE}))]

    assert played([*old, *new]).texts == ("9",)


def test_a_digit_that_is_part_of_a_number_does_not_speak_against_it() -> None:
    part = [read(2, ("2", 1.0, HERE)), tracks(2, {7: HERE})]

    percept = played([*known(), *part])

    assert percept.texts == ("23",)
    assert percept.scores.tolist() == [1.0]


def test_a_name_and_a_number_stand_together() -> None:
    names = [m for k in (2, 3) for m in (read(k, ("weiss", 1.0, HERE)), tracks(k, {7: HERE}))]

    assert played([*known(), *names]).texts == ("23 WEISS",)


def test_a_reading_belongs_to_the_place_of_its_own_frame() -> None:
    before, now = HERE, (130.0, 100.0, 170.0, 200.0)  # the track is where the text was not yet
    late = [tracks(3, {7: now}, speed=30.0), read(3, ("5", 1.0, now))]

    percept = played([read(2, ("23", 1.0, before)), *late, tracks(4, {7: now})], votes=1.0)

    assert percept.texts == ("23",)


def test_a_text_where_two_persons_overlap_is_nobodys() -> None:
    behind = (110.0, 100.0, 150.0, 200.0)
    both = {7: HERE, 8: behind}

    messages = [m for k in range(4) for m in (read(k, ("23", 1.0, HERE)), tracks(k, both))]

    assert played(messages).texts == ()


def test_a_new_track_where_one_ended_takes_the_name_over_in_doubt() -> None:
    gone = [tracks(seq, {}) for seq in range(2, 12)]

    percept = played([*known(), *gone, tracks(12, {9: (110, 100, 150, 200)})])

    assert percept.texts == ("23",)
    assert percept.ids.tolist() == [9]
    assert percept.scores[0] == pytest.approx(0.7)


def test_a_reading_that_agrees_ends_the_doubt() -> None:
    again = [read(12, ("23", 1.0, HERE)), tracks(12, {9: HERE})]

    percept = played([*known(), tracks(2, {}), tracks(11, {9: HERE}), *again])

    assert percept.scores.tolist() == [1.0]


@pytest.mark.parametrize(
    ("box", "seq", "memory"),
    [(THERE, 12, 90), (HERE, 200, 90), (HERE, 12, 0)],
    ids=["too far", "too late", "no memory"],
)
def test_a_track_that_cannot_be_the_lost_person_has_no_name(
    box: Box, seq: int, memory: int
) -> None:
    percept = played([*known(), tracks(2, {}), tracks(seq, {9: box})], memory=memory)

    assert percept.texts == ()


def test_of_two_that_could_be_the_lost_person_neither_is() -> None:
    twins = {8: (95.0, 100.0, 135.0, 200.0), 9: (104.0, 100.0, 144.0, 200.0)}

    assert played([*known(), tracks(2, {}), tracks(3, twins)]).texts == ()


def test_a_number_is_on_one_shirt_of_a_team_and_may_be_on_one_of_each() -> None:
    both = {7: HERE, 8: THERE}

    def seen(colour: tuple[int, int, int]) -> list[Any]:
        found: list[Any] = []
        for k in range(4):
            readings = [("23", 1.0, HERE), *([("23", 1.0, THERE)] if k < 3 else [])]
            shirts = roi(k, (HERE, RED), (THERE, colour))
            found += [read(k, *readings), tracks(k, both), shirts]
        return [*found, tracks(4, both)]

    assert played(seen(RED)).ids.tolist() == [7]
    assert played(seen(BLUE)).ids.tolist() == [7, 8]


def looks(seq: int, behind: int) -> int:
    """Return how many looks a person at `HERE` in frame `seq` has of a ROI older than its track."""
    subject = NameTracks(NameTracksSettings())
    subject.open()
    ahead = (HERE[0] + 100, HERE[1], HERE[2] + 100, HERE[3])
    subject.on_tracks(tracks(seq + behind, {7: ahead}, speed=100.0))
    shown = roi(seq, (HERE, RED), (ahead, BLUE))["roi"]
    assert isinstance(shown, Frame)
    subject.on_roi(shown)
    state = subject.state()
    red = np.abs(state.colours[0] - np.array(RED)).max() < 1
    return int(state.looks[0]) if red else 0


def test_shirts_of_an_older_picture_are_where_the_tracks_were() -> None:
    assert looks(4, behind=1) == 1
    assert looks(4, behind=2) == 0  # before their history


def test_who_is_read_again_is_no_longer_lost() -> None:
    person, again = Person(track=1, seq=0, lost=True), Person(track=2, seq=90)
    for each in (person, again):
        each.show(np.array(RED, np.float32), 110)
        each.hear("23", 1.0)
        each.hear("23", 1.0)

    assert settled([again, person], least=2.0, colour=110) == [again]


def test_nobody_in_another_shirt_is_found_again() -> None:
    lost, new = Person(track=1, seq=0, lost=True), Person(track=2, seq=1)
    for each, colour in ((lost, RED), (new, BLUE)):
        each.box = np.array(HERE, np.float32)
        each.show(np.array(colour, np.float32), 110)

    assert found_again([new], [lost], 1, colour=110) == []
    assert found_again([new], [lost], 1, colour=700) == [(new, lost)]


def test_two_who_exchange_their_tracks_take_their_names_with_them() -> None:
    left, right = (100.0, 100.0, 140.0, 200.0), (150.0, 100.0, 190.0, 200.0)
    messages: list[Any] = []
    for k in range(8):
        readings = read(k, ("23", 1.0, left), ("9", 1.0, right))
        shirts = roi(k, (left, RED), (right, BLUE))
        messages += [readings, tracks(k, {7: left, 8: right}), shirts]
    for k in range(8, 14):  # the tracks stay, the players do not
        messages += [tracks(k, {7: left, 8: right}), roi(k, (left, BLUE), (right, RED))]

    percept = played(messages)

    assert dict(zip(percept.ids.tolist(), percept.texts, strict=True)) == {7: "9", 8: "23"}
    assert percept.scores.max() < 0.8


def test_a_name_survives_that_others_were_read_before_it_was_passed_on() -> None:
    lost, again = Person(track=1, seq=0), Person(track=2, seq=1)
    for text in ("16", "16", "16", "18", "16"):
        lost.hear(text, 1.0)

    again.take_over(lost, 2.0)

    assert again.said(2.0)[0] == "16"
    assert again.votes["16"] == pytest.approx(2.0, abs=0.01)


def test_a_successor_knows_everybody() -> None:
    first, second = NameTracks(NameTracksSettings()), NameTracks(NameTracksSettings())
    for each in (first, second):
        each.open()
    for k in range(2):
        first.on_percept(read(k, ("23", 1.0, HERE))["percept"])  # type: ignore[arg-type]
        first.on_tracks(tracks(k, {7: HERE}))

    second.restore(first.state())

    assert second.on_tracks(tracks(2, {7: HERE})).texts == ("23",)
    assert second.on_tracks(tracks(3, {})).texts == ()
    assert second.on_tracks(tracks(4, {9: HERE})).texts == ("23",)


def test_another_stream_has_other_people() -> None:
    subject = NameTracks(NameTracksSettings())
    subject.open()
    for k in range(2):
        subject.on_percept(read(k, ("23", 1.0, HERE))["percept"])  # type: ignore[arg-type]
        subject.on_tracks(tracks(k, {7: HERE}))

    subject.on_stream(header(stream="other"))

    assert subject.on_tracks(tracks(0, {7: HERE})).texts == ()


def test_texts_that_do_not_fit_the_boxes_and_raw_pixels_are_refused() -> None:
    percept = read(0, ("23", 1.0, HERE))["percept"]
    assert isinstance(percept, Percept)
    wrong = Percept(
        header=header(0), boxes=percept.boxes, ids=percept.ids, scores=percept.scores,
        texts=("23", "24"),
    )  # fmt: skip
    raw = Frame(header=header(0), pixels=np.zeros((4, 4), np.uint8), window=(0, 0, 600, 300))

    with pytest.raises(MessageError, match="expected one for each box, got 2 for 1 boxes"):
        drive(NameTracks, [{"percept": wrong}])
    with pytest.raises(MessageError, match="expected pixels of 8 bit"):
        drive(NameTracks, [tracks(0, {7: HERE}), {"roi": raw}])


@pytest.mark.parametrize(
    ("name", "value"), [("least_score", 2.0), ("votes", 0.0), ("memory", -1), ("colour", 900.0)]
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name}: "):
        drive(NameTracks, [tracks(0, {})], {name: value})
