"""Versions of a detector are compared by match and scale, in the words of its own bench."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.detector_versions import main, rows_of, rows_of_states
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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["detector.onnx", "--wide", "."],
            "versions: expected NAME=FILE.onnx, got 'detector.onnx'",
        ),
        (["new=detector.onnx"], "data: expected --football, --wide or --sequence, got none"),
    ],
)
def test_wrong_words_are_refused_in_a_sentence(words: list[str], said: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(main, words)

    assert done.exit_code == 1
    assert said in done.output
    assert not isinstance(done.exception, SettingsError)
