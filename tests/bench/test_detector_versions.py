"""Versions of a detector are compared by match and scale, in the words of its own bench."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from bench.detector_scoring import Looker
from bench.detector_versions import main, rows_of, rows_of_states
from drivers.scenes.soccer import SoccerScene
from pipeline.boxes import iou
from pipeline.errors import SettingsError

BALL = {"class": "ball", "present": 4, "precision": 0.5, "recall": 0.25, "average_precision": 0.2}


def test_each_match_has_a_row_where_there_are_several() -> None:
    report = {"data": "football", "scale": 0.25, "classes": [BALL], "matches": {}}
    both = report | {"matches": {"a": [BALL], "b": [BALL | {"among_3": 0.75}]}}

    assert [row["match"] for row in rows_of("new", report)] == ["all"]
    assert [row["match"] for row in rows_of("new", both)] == ["all", "a", "b"]
    assert [row["among 3"] for row in rows_of("new", both)] == [None, None, 0.75]


def test_each_state_of_a_ball_has_a_row() -> None:
    report = {"data": "S", "scale": 0.25, "among": {"free": {"frames": 9, "share": 0.5}}}

    (row,) = rows_of_states("new", report)

    assert (row["class"], row["present"], row["among 3"]) == ("ball, free", 9, 0.5)


@pytest.mark.lengthy
def test_a_picture_is_enlarged_into_a_larger_input_and_found_where_it_is() -> None:
    scene = SoccerScene(size_px=(1920, 1080), rate_hz=25, seed=5)
    small = cv2.resize(scene.picture(0), (480, 270), interpolation=cv2.INTER_AREA)
    usual, larger = (
        Looker("", {}, 0.25, 1, confidence=0.3, input_px=size) for size in ((0, 0), (736, 416))
    )

    found, enlarged = usual.look(small)["player"][0], larger.look(small)["player"][0]

    assert (usual.input_px, larger.input_px) == ((480, 288), (736, 416))
    assert len(found) > 5
    assert np.mean(iou(found, enlarged).max(1) > 0.5) > 0.7


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["detector.onnx", "--wide", "."],
            "versions: expected NAME=FILE.onnx[@WIDTHxHEIGHT], got 'detector.onnx'",
        ),
        (["new=detector.onnx"], "data: expected --football, --wide or --sequence, got none"),
    ],
)
def test_wrong_words_are_refused_in_a_sentence(words: list[str], said: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(main, words)

    assert done.exit_code == 1
    assert said in done.output
    assert not isinstance(done.exception, SettingsError)
