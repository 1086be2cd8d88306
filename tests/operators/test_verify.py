"""Verify: a candidate is genuine where encoder and detector take it for one at full resolution."""

from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from operators.verify import Verify, VerifySettings
from pipeline import Detections, Frame, RoiFeatures, SettingsError, Tracks
from pipeline.cli import commands
from pipeline.settings import build
from pipeline.testing import drive, header
from tests.operators.policy.made_up import tracks

NAMES = ("ball", "player")
WINDOW = (480, 270, 960, 540)


def detections(*objects: tuple[str, float, float, float, float], channels: int = 2) -> Detections:
    """Return objects (class, score, centre x, centre y, height); as wide as high."""
    rows = np.array([o[1:] for o in objects], np.float32).reshape(-1, 4)
    half = rows[:, 3:] / 2
    return Detections(
        header=header(0),
        boxes=np.hstack([rows[:, 1:3] - half, rows[:, 1:3] + half]),
        angles=np.zeros(len(rows), np.float32),
        scores=rows[:, 0],
        labels=np.array([NAMES.index(o[0]) for o in objects], np.int32),
        features=np.ones((len(rows), channels), np.float32),
        names=NAMES,
    )


def roi(window: tuple[int, int, int, int] = WINDOW) -> Frame:
    """Return the ROI of this window."""
    left, top, right, bottom = window
    return Frame(
        header=header(0), pixels=np.zeros((bottom - top, right - left, 3), np.uint8),
        window=window, pixel_format="rgb8",
    )  # fmt: skip


def verified(world: Tracks, closer: Detections, genuine: dict[int, float]) -> dict[int, float]:
    features = RoiFeatures(
        header=header(0), ids=np.array(list(genuine), np.int32),
        features=np.ones((len(genuine), 3), np.float32),
        genuine=np.array(list(genuine.values()), np.float32),
    )  # fmt: skip
    given = {"features": features, "closer": closer, "tracks": world, "roi": roi()}
    (answer,) = drive(Verify, [given])
    assert len(answer.features) == len(answer.ids)
    return dict(zip(answer.ids.tolist(), answer.genuine.tolist(), strict=True))


BALL = tracks(0, (1, 0, 700, 400, 0))


@pytest.mark.parametrize(
    ("score", "encoder", "expected"),
    [(0.5, 0.5, 0.5), (0.7, 0.5, 0.775), (0.5, 0.8, 0.691), (0.7, 0.8, 0.885), (0.2, 0.5, 0.117)],
)
def test_both_networks_count(score: float, encoder: float, expected: float) -> None:
    closer = detections(("ball", score, 702, 401, 12))

    assert verified(BALL, closer, {1: encoder})[1] == pytest.approx(expected, abs=2e-3)


def test_what_the_detector_does_not_find_in_the_roi_is_not_genuine() -> None:
    for closer in (detections(), detections(("ball", 0.9, 740, 400, 12))):
        assert verified(BALL, closer, {1: 0.9})[1] == pytest.approx(0.0016, abs=1e-4)


def test_people_keep_what_the_encoder_says() -> None:
    world = tracks(0, (1, 1, 700, 400, 0))

    assert verified(world, detections(), {1: 0.3})[1] == pytest.approx(0.3)


def test_a_candidate_at_the_edge_of_the_roi_is_not_judged() -> None:
    assert verified(tracks(0, (1, 0, 485, 400, 0)), detections(), {1: 0.9}) == {}


def test_an_object_that_is_no_track_any_more_is_passed_on() -> None:
    assert verified(BALL, detections(), {9: 0.4})[9] == pytest.approx(0.4)


def test_a_ball_that_is_too_large_beside_people_is_none() -> None:
    world = tracks(0, (1, 0, 700, 400, 0), (2, 1, 800, 400, 0))

    assert verified(world, detections(("ball", 0.9, 700, 400, 20)), {1: 0.5})[1] < 0.001
    assert verified(world, detections(("ball", 0.9, 700, 400, 6)), {1: 0.5})[1] > 0.9


def test_a_candidate_that_the_context_misses_is_judged_where_it_is_foreseen() -> None:
    world = tracks(0, (1, 0, 700, 400, 0), unseen=(1,))

    assert verified(world, detections(("ball", 0.8, 702, 400, 12)), {1: 0.5})[1] > 0.8


def test_one_find_verifies_the_nearest_candidate_only() -> None:
    world = tracks(0, (1, 0, 700, 400, 0), (2, 0, 711, 400, 0))

    found = verified(world, detections(("ball", 0.8, 709, 400, 12)), {1: 0.5, 2: 0.5})

    assert [found[1], found[2]] == pytest.approx([0.0004, 0.883], abs=1e-3)


def test_an_encoder_that_verifies_nothing_says_nothing() -> None:
    closer = detections(("ball", 0.5, 700, 400, 12))

    assert verified(BALL, closer, {1: 1.0})[1] == pytest.approx(0.5, abs=1e-3)


def test_nothing_in_the_roi_is_an_empty_answer() -> None:
    assert verified(tracks(0), detections(), {}) == {}


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"reach_px": -1}, "reach_px: must not be negative, got -1"),
        ({"target": ""}, "target: expected the name of a class, got none"),
        ({"largest": 0.01}, "largest: must be above smallest, got 0.01"),
    ],
)
def test_wrong_settings_are_told_in_a_sentence(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence):
        build(VerifySettings, values, "verify")


def test_a_target_that_the_detector_does_not_know_is_refused() -> None:
    result = CliRunner().invoke(commands, ["check", "tracking", "--set", "verify.target=bal"])

    assert isinstance(result.exception, SettingsError)
    assert "verify.target: expected one of player, referee, ball, got bal" in str(result.exception)
