"""Objects that cross are told apart by the colours that the picture shows."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from operators.association import Association, AssociationSettings
from operators.association.appearance import LEAST_PX, likeness, worn
from pipeline import Detections, Frame, SettingsError, Tracks
from pipeline.codec import dumps, loads
from pipeline.testing import drive, header

RED, WHITE, LAWN = (210, 30, 40), (240, 240, 240), (60, 130, 50)
WIDE, HIGH, TOP = 40, 80, 200  # of a person, sensor pixels
FIELD_PX, SCALE = (960, 540), 4
MEETING = 8  # frame of those who meet
RED_LEFT = 400.0 - 6 * 6  # where one of them is six frames before and after


def people(seq: int, *at: tuple[float, Any]) -> tuple[Detections, Frame]:
    """Return what is detected in a frame, and the picture at a quarter of the sides.

    Each person has a left side, in sensor pixels, and a shirt. Later ones are before the others.
    """
    boxes = np.array([[x, TOP, x + WIDE, TOP + HIGH] for x, _ in at], np.float32).reshape(-1, 4)
    pixels = np.full((FIELD_PX[1] // SCALE, FIELD_PX[0] // SCALE, 3), LAWN, np.uint8)
    for (x0, y0, x1, y1), (_, shirt) in zip((boxes / SCALE).astype(int), at, strict=True):
        pixels[y0:y1, x0:x1] = shirt
    found = Detections(
        header=header(seq),
        boxes=boxes,
        angles=np.zeros(len(at), np.float32),
        scores=np.full(len(at), 0.9, np.float32),
        labels=np.zeros(len(at), np.int32),
        features=np.zeros((len(at), 2), np.float32),
        names=("player",),
    )
    return found, Frame(
        header=header(seq), pixels=pixels, window=(0, 0, *FIELD_PX), pixel_format="rgb8"
    )


def turning() -> list[tuple[Detections, Frame]]:
    """Return two people who run towards one another, meet, and turn round."""
    frames = []
    for k in range(MEETING * 2):
        red = 400.0 - 6 * abs(MEETING - k)
        hidden = abs(MEETING - k) <= 1
        frames.append(people(k, *([] if hidden else [(red, RED)]), (800 - red, WHITE)))
    return frames


def tracked(frames: list[tuple[Detections, Frame]], **values: Any) -> list[Tracks]:
    return drive(Association, [{"detections": d, "frame": f} for d, f in frames], values)


def id_at(tracks: Tracks, left: float) -> int:
    (row,) = np.flatnonzero(np.abs(tracks.boxes[:, -1, 0] - left) < 1)
    return int(tracks.ids[row])


def test_two_who_meet_and_turn_round_keep_their_ids_by_their_shirts() -> None:
    frames = turning()

    first, last = (tracked(frames)[k] for k in (2, 14))

    assert id_at(last, RED_LEFT) == id_at(first, RED_LEFT)
    assert id_at(last, 800 - RED_LEFT) == id_at(first, 800 - RED_LEFT)


@pytest.mark.parametrize("how", ["no picture", "grey", "switched off"])
def test_without_colours_they_are_told_apart_by_motion_alone(how: str) -> None:
    frames = turning()
    alone = drive(Association, [d for d, _ in frames], {})

    green = [replace(f, pixels=f.pixels[..., 1].copy(), pixel_format="gray8") for _, f in frames]
    found = {
        "no picture": drive(Association, [{"detections": d, "frame": None} for d, _ in frames]),
        "grey": tracked([(d, f) for (d, _), f in zip(frames, green, strict=True)]),
        "switched off": tracked(frames, colour_difference=0.0),
    }[how]

    assert id_at(alone[14], RED_LEFT) == id_at(alone[2], 800 - RED_LEFT)
    assert [t.ids.tolist() for t in found] == [t.ids.tolist() for t in alone]
    assert all(np.array_equal(a.boxes, b.boxes) for a, b in zip(found, alone, strict=True))


def test_a_successor_knows_the_colours() -> None:
    frames = turning()
    old, successor = (Association(AssociationSettings()) for _ in range(2))
    for subject in (old, successor):
        subject.open()
    for pair in frames[:MEETING]:
        old.on_detections_frame(*pair)

    successor.restore(loads(type(old.state()), dumps(old.state())))

    for pair in frames[MEETING:]:
        expected = old.on_detections_frame(*pair)
        assert dumps(successor.on_detections_frame(*pair)) == dumps(expected)
    assert id_at(expected, RED_LEFT - 6) == 1


def test_of_what_is_small_nothing_is_known() -> None:
    _, frame = people(0, (100.0, RED))
    tall = LEAST_PX * SCALE
    boxes = np.array([[100, TOP, 120, TOP + tall], [100, TOP, 120, TOP + tall - 1]], np.float32)

    found = worn(boxes, frame)

    assert not np.isnan(found[0]).any()
    assert np.isnan(found[1]).all()


def test_colours_are_those_of_the_place_in_a_window_of_the_field() -> None:
    pixels = np.full((54, 96, 3), LAWN, np.uint8)
    pixels[10:30, 20:30] = RED
    frame = Frame(header=header(0), pixels=pixels, window=(480, 270, 864, 486), pixel_format="rgb8")
    box = np.array([[480 + 80, 270 + 40, 480 + 120, 270 + 120]], np.float32)

    (found,) = worn(box, frame)

    assert found[0, 1] > 160


COLOURS = arrays(np.float32, (4, 2, 3), elements=st.floats(0, 255, width=32), fill=st.nothing())
UNKNOWN = arrays(np.bool_, (4, 2))


@given(known=COLOURS, seen=COLOURS, unknown=UNKNOWN, difference=st.floats(0.01, 1000))
def test_likeness_is_above_nothing_and_whole_where_nothing_is_known(
    known: np.ndarray, seen: np.ndarray, unknown: np.ndarray, difference: float
) -> None:
    known[unknown] = np.nan
    found = likeness(known, seen, difference)

    assert found.shape == (4,)
    assert (found > 0).all()
    assert (found <= 1).all()
    assert (found[unknown.all(1)] == 1).all()
    assert likeness(seen, seen, difference).tolist() == [1] * 4


def test_each_part_that_differs_counts() -> None:
    known, seen = (np.full((3, 2, 3), 128, np.float32) for _ in range(2))
    seen[1, 0, 1] += 40
    seen[2, :, 1] += 40

    assert likeness(known, seen, 40.0).tolist() == pytest.approx([1, np.exp(-1), np.exp(-2)])


def test_a_part_outside_of_the_picture_is_unknown() -> None:
    _, frame = people(0, (100.0, RED))
    low = np.array([[100, FIELD_PX[1] - 40, 140, FIELD_PX[1] + 60]], np.float32)

    (found,) = worn(low, frame)

    assert not np.isnan(found[0]).any()
    assert np.isnan(found[1]).all()


def test_pictures_that_are_missing_change_nothing_that_is_known() -> None:
    frames = turning()
    pairs = [{"detections": d, "frame": f if k % 3 else None} for k, (d, f) in enumerate(frames)]

    found = drive(Association, pairs)

    assert id_at(found[14], RED_LEFT) == id_at(found[2], RED_LEFT)
    assert Association.frame.keep == "every"


def test_a_negative_difference_is_refused() -> None:
    with pytest.raises(SettingsError, match="colour_difference: must be at least 0"):
        AssociationSettings(colour_difference=-1.0)
