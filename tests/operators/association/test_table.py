"""Colours of tracks: those of the detections that they were matched with."""

import numpy as np

from operators.association.kalman import motion_model
from operators.association.table import COLOUR_GAIN, Table, born, empty, see
from pipeline import Detections
from pipeline.testing import header

MODEL = motion_model(0.001, 0.01)
UNKNOWN = np.full((2, 3), np.nan, np.float32)


def detections(count: int) -> Detections:
    boxes = np.array([[50 * k, 0, 50 * k + 10, 30] for k in range(count)], np.float32)
    return Detections(
        header=header(0),
        boxes=boxes,
        angles=np.zeros(count, np.float32),
        scores=np.ones(count, np.float32),
        labels=np.zeros(count, np.int32),
        features=np.zeros((count, 0), np.float32),
        names=("player",),
    )


def tinted(*tints: float) -> np.ndarray:
    return np.stack([np.full((2, 3), tint, np.float32) for tint in tints])


def table(*tints: float) -> Table:
    found = detections(len(tints))
    return born(empty(4, 0), np.arange(len(tints)), found, tinted(*tints), MODEL)


def test_a_new_track_has_the_colours_of_its_own_detection() -> None:
    found = born(table(10), np.array([2, 0]), detections(3), tinted(1, 2, 3), MODEL)

    assert found.colours[:, 0, 0].tolist() == [10, 3, 1]


def test_colours_follow_those_of_the_matched_detection() -> None:
    known = table(10, 20, 30)

    found = see(known, np.array([[0, 2], [2, 0]]), detections(3), tinted(130, 0, 110), MODEL)

    expected = [10 + COLOUR_GAIN * 100, 20, 30 + COLOUR_GAIN * 100]
    assert found.colours[:, 1, 2].tolist() == expected


def test_where_a_detection_has_none_they_stay_and_where_a_track_has_none_they_begin() -> None:
    known = table(10, 20)
    known.colours[1] = UNKNOWN

    found = see(
        known, np.array([[0, 0], [1, 1]]), detections(2), np.stack([UNKNOWN, tinted(7)[0]]), MODEL
    )

    assert found.colours[:, 0, 0].tolist() == [10, 7]
