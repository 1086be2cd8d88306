"""Scores of detections."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="needs the train extra")

from operators.saliency.evaluate import choose, collect, development, main, scenes, shrunk
from operators.saliency.judging import (
    Tally,
    at_threshold,
    average_precision,
    best_threshold,
    find_hits,
)
from operators.saliency.saliency import SaliencySettings
from pipeline.inference import Network
from tests.operators.networks import constant_network
from tests.operators.training.labelled_stills import match_of_stills

PERSON = [10.0, 10.0, 20.0, 40.0]


def boxes(*rows: list[float]) -> np.ndarray:
    """Return boxes (n, 4)."""
    return np.array(rows, np.float32).reshape(-1, 4)


def flags(*values: bool) -> np.ndarray:
    """Return booleans (n,)."""
    return np.array(values, np.bool_)


def tally(*rows: tuple[float, bool], present: int) -> Tally:
    """Return a tally of detections, each given as confidence and whether it is a hit."""
    scores, hits = zip(*rows, strict=True)
    return Tally(scores=np.array(scores, np.float32), hits=flags(*hits), present=present)


def test_a_second_detection_of_one_object_is_no_hit() -> None:
    hits, counts = find_hits(boxes(PERSON, PERSON), boxes(PERSON), flags(False))

    assert hits.tolist() == [True, False]
    assert counts.tolist() == [True, True]


def test_a_box_that_overlaps_too_little_is_no_hit() -> None:
    hits, _ = find_hits(boxes([10, 10, 20, 24]), boxes(PERSON), flags(False))

    assert hits.tolist() == [False]


def test_a_detection_that_only_fits_a_hidden_object_does_not_count() -> None:
    hits, counts = find_hits(boxes(PERSON), boxes(PERSON), flags(True))

    assert hits.tolist() == [False]
    assert counts.tolist() == [False]


def test_each_detection_takes_the_object_it_fits_best() -> None:
    truth = boxes(PERSON, [12, 10, 22, 40])

    hits, _ = find_hits(boxes([12, 10, 22, 40], PERSON), truth, flags(False, False))

    assert hits.all()


def test_a_ball_may_be_judged_by_its_centre() -> None:
    near, far = [4.0, 0.0, 8.0, 4.0], [8.0, 0.0, 12.0, 4.0]
    ball = boxes([0, 0, 4, 4])

    assert find_hits(boxes(near), ball, flags(False), by_centre=True)[0].tolist() == [True]
    assert find_hits(boxes(far), ball, flags(False), by_centre=True)[0].tolist() == [False]


def test_frames_without_objects_and_without_detections_are_scored() -> None:
    assert find_hits(boxes(), boxes(PERSON), flags(False))[0].shape == (0,)
    assert find_hits(boxes(PERSON), boxes(), flags())[0].tolist() == [False]


def test_precision_and_recall_count_hits_above_the_threshold() -> None:
    found = tally((0.9, True), (0.8, False), (0.7, True), (0.1, False), present=4)

    figures = at_threshold(found, 0.5)

    assert figures["precision"] == pytest.approx(2 / 3)
    assert figures["recall"] == pytest.approx(2 / 4)


def test_average_precision_is_one_only_when_all_hits_come_first() -> None:
    perfect = tally((0.9, True), (0.8, True), (0.1, False), present=2)
    late = tally((0.9, False), (0.8, True), (0.7, True), present=2)

    assert average_precision(perfect) == pytest.approx(1)
    assert average_precision(late) == pytest.approx(2 / 3)


def test_the_chosen_threshold_keeps_the_hits_and_drops_the_rest() -> None:
    found = tally((0.912, True), (0.805, True), (0.5, False), (0.4, False), present=2)

    assert best_threshold(found) == pytest.approx(0.8)


@pytest.mark.parametrize(("side", "size_px"), [(0.7071, (339, 191)), (0.5, (240, 135))])
def test_a_leaner_context_shows_the_same_field_in_fewer_pixels(
    side: float, size_px: tuple[int, int]
) -> None:
    picture = np.zeros((270, 480, 3), np.uint8)
    picture[:, 240:] = 200

    small = shrunk(picture, side)

    assert (small.shape[1], small.shape[0]) == size_px
    assert small.mean() == pytest.approx(100, abs=1)


def test_players_found_in_a_leaner_context_are_judged_where_they_are() -> None:
    (pictured,) = scenes([60_000], 1)

    players = collect([pictured], SaliencySettings(), 0.7071)["player"]

    assert players.hits.sum() > players.present / 2


def test_thresholds_are_chosen_on_stills_for_development_alone(tmp_path: Path) -> None:
    match_of_stills(tmp_path, "08fd33_1", "798b45_1", "aa_1")

    found = list(development(tmp_path))

    assert len(found) == 1
    assert found[0].picture.shape == (270, 480, 3)
    assert np.allclose(found[0].boxes[1], [144, 110, 156, 140])


def test_stills_to_choose_on_are_refused_where_nothing_is_chosen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["--stills", str(match_of_stills(tmp_path, "08fd33_1"))])

    assert "--stills: expected --choose as well" in capsys.readouterr().err


def test_a_chosen_confidence_of_the_ball_is_that_of_its_place(tmp_path: Path) -> None:
    # found twice as large as it is, at the right place
    rows = np.zeros((1, 300, 6), np.float32)
    rows[0, 0] = (245, 154, 255, 164, 0.4, 2)
    weights = constant_network(
        tmp_path / "n.onnx", rows, names="['player', 'referee', 'ball']", confidence="{'ball': 0.9}"
    )
    match_of_stills(tmp_path, "08fd33_1")

    limits = choose(Path(weights), development(tmp_path), 1)

    assert limits["ball"] == 0.4
    assert "0.4" in Network(Path(weights), threads=1).metadata["confidence"]
