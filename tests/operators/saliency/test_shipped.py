"""The detector that fovea ships, on a procedural scene it never saw."""

import cv2
import numpy as np
import pytest

from drivers.soccer import SoccerScene
from operators.saliency import Saliency
from pipeline import Detections, Frame
from pipeline.boxes import iou
from pipeline.testing import drive, header

HELD_OUT_SEED = 70_001  # neither trained on, nor used to choose thresholds or to score


@pytest.fixture(scope="module")
def answers() -> list[tuple[Detections, np.ndarray, tuple[str, ...]]]:
    """Detections, true boxes and true labels of a few well-spaced frames."""
    scene = SoccerScene(size_px=(1920, 1080), seed=HELD_OUT_SEED)
    frames, truths = [], []
    for index in (0, 120, 240, 360):
        pixels = cv2.resize(scene.picture(index), (480, 270), interpolation=cv2.INTER_AREA)
        frames.append(
            Frame(header=header(index), pixels=np.asarray(pixels), window=(0, 0, 1920, 1080))
        )
        truths.append(scene.truth(index))
    scene.close()
    found = drive(Saliency, frames)
    return [(f, t.boxes, t.labels) for f, t in zip(found, truths, strict=True) if t]


def test_most_players_of_an_unseen_match_are_found(
    answers: list[tuple[Detections, np.ndarray, tuple[str, ...]]],
) -> None:
    found, present = 0, 0
    for detections, boxes, labels in answers:
        players = boxes[[label in ("player", "goalkeeper") for label in labels]]
        mine = detections.boxes[detections.labels == detections.names.index("player")]
        found += int((iou(mine, players) >= 0.5).any(0).sum())
        present += len(players)

    assert present > 20
    assert found / present > 0.7


def test_features_come_along_for_every_object(
    answers: list[tuple[Detections, np.ndarray, tuple[str, ...]]],
) -> None:
    for detections, _, _ in answers:
        assert detections.names == ("player", "referee", "ball")
        assert detections.features.shape == (len(detections.scores), 64)
        assert np.isfinite(detections.features).all()
