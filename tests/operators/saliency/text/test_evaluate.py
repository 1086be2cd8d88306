"""Scores of the text detector: what counts as found."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("PIL", reason="needs the text extra")

from operators.saliency.text import evaluate
from operators.saliency.text.evaluate import (
    WAYS,
    Look,
    look,
    looks,
    main,
    mark,
    quads_of,
    settings_for,
)
from operators.saliency.text.quads import corners
from operators.saliency.text.streets import FULL_PX, Picture
from pipeline import Detections
from pipeline.testing import header

WORDS = np.array([[400, 200, 160, 24, 0.5], [900, 500, 80, 20, 0], [200, 600, 90, 30, 0]])


def found(boxes: np.ndarray) -> Detections:
    """Return detections of turned boxes, best first."""
    half = boxes[:, 2:4] / 2
    return Detections(
        header=header(0),
        boxes=np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], 1).astype(np.float32),
        angles=boxes[:, 4].astype(np.float32),
        scores=np.linspace(0.9, 0.5, len(boxes), dtype=np.float32),
        labels=np.zeros(len(boxes), np.int32),
        features=np.zeros((len(boxes), 0), np.float32),
        names=("text",),
    )


def told(*ignored: bool) -> Look:
    quads = corners(WORDS.astype(np.float32))
    empty = np.zeros((180, 320, 3), np.uint8)
    seen = Picture(pixels=empty, quads=quads, ignored=np.array(ignored, np.bool_))
    return look(seen, 0, FULL_PX)


def test_detections_have_the_corners_of_the_words_that_they_found() -> None:
    np.testing.assert_allclose(quads_of(found(WORDS)), corners(WORDS.astype(np.float32)), atol=0.01)


def test_a_word_found_at_another_angle_counts_as_upright_box_alone() -> None:
    mirrored = WORDS.copy()
    mirrored[0, 4] *= -1

    hits = {way: mark(found(mirrored), told(False, False, False), way)[1] for way in WAYS}

    assert hits["upright"].tolist() == [True, True, True]
    assert hits["polygon"].tolist() == [False, True, True]


def test_a_detection_on_a_word_that_cannot_be_read_does_not_count() -> None:
    part = WORDS.copy()
    part[2, 2] = 30  # a third of the word

    scores, hits = mark(found(part), told(False, False, True), "upright")

    assert hits.tolist() == [True, True]
    assert len(scores) == 2


def test_a_word_is_found_once() -> None:
    twice = np.concatenate([WORDS[1:2], WORDS[1:2]])

    _, hits = mark(found(twice), told(False, False, False), "polygon")

    assert hits.tolist() == [True, False]


def test_seeds_of_development_and_of_the_tables_are_not_those_of_training() -> None:
    from operators.saliency.text.settings import TRAIN_SEEDS

    assert all(first >= TRAIN_SEEDS for first in evaluate.SEEDS.values())
    first, again = (next(looks("drives", evaluate.SEEDS["held-out"], 1)) for _ in range(2))
    np.testing.assert_array_equal(first.frame.pixels, again.frame.pixels)
    assert (~first.ignored).any()


def test_a_larger_picture_is_read_at_the_same_resolution() -> None:
    seen = next(looks("drives", 50_000, 1, (1920, 1080)))

    assert seen.frame.pixels.shape == (270, 480, 3)
    assert seen.frame.window == (0, 0, 1920, 1080)
    assert seen.quads[..., 0].max() > 1280
    assert settings_for("text", (1920, 1080), 0.1).input_px == (480, 288)
    assert settings_for("text", (1280, 720), 0.1).input_px == (320, 192)


def test_the_command_writes_what_it_prints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "report.json"

    main(["--kind", "streets", "--pictures", "3", "--json", str(report)])

    told = json.loads(report.read_text())
    assert told["on"] == "development streets"
    assert set(told["figures"]) == set(WAYS)
    assert f"recall {told['figures']['polygon']['recall']:.3f}" in capsys.readouterr().out


@pytest.mark.parametrize("words", ["1281x720", "1280", "0x0", "wide"])
def test_a_size_without_a_quarter_is_refused(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["--size", words])

    assert "argument --size" in capsys.readouterr().err


def test_photographs_are_scored_with_a_folder_of_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (["--kind", "photographs"], ["--stills", str(tmp_path)]):
        with pytest.raises(SystemExit):
            main(words)
        assert "--stills: --kind photographs and a folder go together" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["--kind", "photographs", "--stills", str(tmp_path)])
    assert "expected photographs (.jpg) for development, got none" in capsys.readouterr().err
