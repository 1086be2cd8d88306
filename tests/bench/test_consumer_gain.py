"""What a window gains the tracker: measured against the same start without a ROI."""

import numpy as np
import pytest

from bench.consumer_gain import (
    DISTANCES,
    FOLLOWED,
    correlation_of,
    rows_of,
    scales_of,
    tries,
    window_at,
)
from operators.tracker.look import Streams
from pipeline import Geometry
from pipeline.boxes import centres
from pipeline.errors import SettingsError

FIELD = Geometry(width_px=1920, height_px=1080, roi_width_px=480, roi_height_px=270, step_px=2)
Box = np.ndarray


class OnlyWithRoi:
    """Keeps its box where the ROI shows its middle, and loses it elsewhere."""

    patience_score = 0.5

    def start(self, streams: Streams, box: Box) -> None:
        self.box = box

    def follow(self, streams: Streams, box: Box) -> tuple[Box, float]:
        left, top, right, bottom = streams.roi.window
        x, y = centres(self.box)
        there = left <= x <= right and top <= y <= bottom
        return (self.box if there else self.box + 5000), 1.0


@pytest.mark.lengthy
def test_a_tracker_that_needs_the_roi_gains_inside_windows_and_nothing_outside():
    found = list(tries(60_000, FOLLOWED + 1, 4, OnlyWithRoi()))
    gains = {d: [t.gain for t in found if t.distance == d] for d in DISTANCES}

    assert found
    assert min(gains[0.0]) > 0
    assert max(gains[2.0]) < min(gains[0.0])
    assert all(rank > 0.5 for rank in correlation_of(found).values())


@pytest.mark.lengthy
def test_rows_are_the_same_every_time_and_state_their_sample():
    rows = [rows_of(list(tries(60_000, FOLLOWED + 1, 4, OnlyWithRoi()))) for _ in range(2)]

    assert rows[0] == rows[1]
    assert {row["clips"] for row in rows[0]} == {1}
    assert rows[0][0]["± over clips"] == float("inf")


@pytest.mark.parametrize("distance", [0.0, 0.5, 1.5])
def test_a_window_is_as_far_from_the_target_as_asked(distance: float):
    box = np.array([950, 530, 970, 550], np.float32)
    window = np.array(window_at(box, np.array([1.0, 0.2]), distance, FIELD), np.float32)

    away = abs(float(centres(window)[0] - centres(box)[0])) / (FIELD.roi_width_px / 2)
    assert away == pytest.approx(distance, abs=2 * FIELD.step_px / FIELD.roi_width_px)


@pytest.mark.parametrize("text", ["", "four", "1", "4,64"])
def test_scales_that_make_no_sense_are_refused(text: str):
    with pytest.raises(SettingsError, match="--scales: expected numbers from 2 to 32"):
        scales_of(text)
