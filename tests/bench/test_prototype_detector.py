"""Ways to look at the prototype's context: detections and truth in, hits by class out."""

import numpy as np

from bench.prototype_detector import LOOKS, Score, possible, previews
from drivers.scenes import PanoramaScene
from drivers.source import Annotations
from pipeline import Detections
from pipeline.testing import header

NAMES = ("player", "referee", "ball")
TRUTH = Annotations(
    boxes=np.array(
        [[0, 0, 400, 900], [2000, 0, 2400, 900], [5000, 0, 5100, 100], [9000, 0, 9400, 900]],
        np.float32,
    ),
    ids=np.arange(4, dtype=np.int32),
    labels=("player", "main referee", "ball", "goalkeeper"),
    visibility=np.array([1, 1, 1, 0.1], np.float32),
)


def seen(*found: tuple[str, int]) -> Detections:
    """Return detections of classes at columns: a person's box, or the ball's."""
    boxes = [[x, 0, x + 400, 900] if name != "ball" else [x, 0, x + 100, 100] for name, x in found]
    return Detections(
        header=header(0),
        boxes=np.array(boxes, np.float32).reshape(-1, 4),
        angles=np.zeros(len(found), np.float32),
        scores=np.full(len(found), 0.9, np.float32),
        labels=np.array([NAMES.index(name) for name, _ in found], np.int32),
        features=np.zeros((len(found), 0), np.float32),
        names=NAMES,
    )


def test_what_is_right_wrong_and_missed_is_counted_by_class() -> None:
    score = Score(times_ms=[50.0])

    score.add(seen(("player", 10), ("player", 2010), ("ball", 5090), ("player", 7000)), TRUTH)

    row = score.row()
    assert (row["player"], row["player, wrong"]) == ("1 of 1", 2)
    assert (row["referee"], row["ball"], row["ball, wrong"]) == ("0 of 1", "1 of 1", 0)
    assert (row["people, any class"], row["people, any class, wrong"]) == ("2 of 2", 1)
    assert row["frames"] == 1.5


def test_what_is_hidden_is_neither_missed_nor_wrongly_found() -> None:
    score = Score(times_ms=[50.0])

    score.add(seen(("player", 9000)), TRUTH)

    assert (score.row()["player"], score.row()["player, wrong"]) == ("0 of 1", 0)


def test_the_previews_are_the_boards_and_the_shipped_network_can_look_in_every_way() -> None:
    frame, truth = next(previews(PanoramaScene(seed=1)))

    assert (frame.pixels.shape, frame.pixel_format) == ((1148, 2040), "bayer_rggb8")
    assert len(truth.ids) == 11
    assert tuple(possible("")) == LOOKS
