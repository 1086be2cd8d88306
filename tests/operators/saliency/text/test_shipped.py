"""The shipped detector of text on clips that it was not trained on."""

import numpy as np
import pytest

pytest.importorskip("PIL", reason="needs the text extra")

from operators.saliency import Saliency
from operators.saliency.detector import Detector
from operators.saliency.judging import at_threshold
from operators.saliency.moved import MovedSaliency
from operators.saliency.saliency import SaliencySettings
from operators.saliency.text.evaluate import collect, look
from operators.saliency.text.roads import roads
from operators.saliency.text.streets import FULL_PX
from pipeline import Frame
from pipeline.testing import drive, header

SHIPPED = SaliencySettings(weights="text", threads=1)
SEEDS = (79_001, 79_002, 79_003)  # neither trained on, nor used to choose, nor in the tables
LEAST = (
    0.55  # of precision and recall; both are about .8 over 200 pictures, with some 30 texts here
)


def test_it_is_known_by_name_and_finds_one_class_of_turned_boxes() -> None:
    detector = Detector(SHIPPED)

    assert (detector.names, detector.kind, detector.channels) == (("text",), "obb", 64)
    assert detector.size_px == (320, 192)


def test_most_texts_of_unseen_streets_are_found_in_a_quarter() -> None:
    seen = [look(p, seq, FULL_PX) for seq, p in enumerate(roads(SEEDS, 4, FULL_PX, 4))]

    for tally in collect(seen, SHIPPED).values():
        row = at_threshold(tally, 0.0)
        assert row["present"] > 15
        assert min(row["precision"], row["recall"]) > LEAST


def test_texts_of_a_larger_context_are_found_by_tiles_with_features() -> None:
    (seen,) = roads(SEEDS[:1], 1, (1920, 1080), 3)
    frame = Frame(header=header(0), pixels=seen.pixels, window=(0, 0, 1920, 1080))

    (found,) = drive(MovedSaliency, [frame], {"weights": "text"})

    assert len(found.scores) > 0
    assert found.features.shape == (len(found.scores), 64)
    assert np.isfinite(found.features).all()
    assert found.angles.any()


def test_an_empty_wall_holds_no_text() -> None:
    wall = np.full((180, 320, 3), 90, np.uint8)
    frame = Frame(header=header(0), pixels=wall, window=(0, 0, *FULL_PX))

    (found,) = drive(Saliency, [frame], {"weights": "text"})

    assert len(found.scores) == 0
