"""Verify: a candidate is genuine where encoder and detector take it for one at full resolution."""

import numpy as np
import pytest

from operators.verify import Verify
from pipeline import Detections, RoiFeatures, Tracks
from pipeline.testing import drive, header
from tests.operators.policy.made_up import tracks
from tests.operators.verify.made_up import detections, roi


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
    [(0.5, 0.5, 0.5), (0.7, 0.5, 0.875), (0.5, 0.8, 0.752), (0.7, 0.8, 0.955), (0.2, 0.5, 0.04)],
)
def test_both_networks_count(score: float, encoder: float, expected: float) -> None:
    closer = detections(("ball", score, 702, 401, 12))

    assert verified(BALL, closer, {1: encoder})[1] == pytest.approx(expected, abs=2e-3)


def test_what_the_detector_does_not_find_in_the_roi_is_not_genuine() -> None:
    assert verified(BALL, detections(), {1: 0.9})[1] < 0.001
    assert verified(BALL, detections(("ball", 0.9, 740, 400, 12)), {1: 0.9})[1] < 0.001


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
