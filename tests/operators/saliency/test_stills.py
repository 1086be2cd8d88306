"""Labelled stills are read with their classes, and what is malformed is named by file and line."""

from pathlib import Path

import numpy as np
import pytest

from operators.saliency.example import ANYONE, NAMES
from operators.saliency.stills import stills
from pipeline.errors import DriverError, FoveaError
from tests.operators.training.labelled_stills import match_of_stills, write_names, write_still


def test_classes_are_those_that_the_names_say(tmp_path: Path) -> None:
    folder = stills(match_of_stills(tmp_path, "aa_1"))

    example = folder.example(folder.files[0])

    assert [NAMES[label] for label in example.labels] == ["ball", "player", "player", "referee"]
    assert example.picture.shape == (540, 960, 3)
    assert np.allclose(example.boxes[1], [288, 220, 312, 280], atol=1e-3)


def test_a_person_of_unknown_class_is_anyone(tmp_path: Path) -> None:
    write_names(tmp_path, "person", "sports ball")
    write_still(tmp_path, "wide_1", [(0, 100, 100, 10, 20), (1, 200, 100, 8, 8)])

    folder = stills(tmp_path)

    assert folder.example(folder.files[0]).labels.tolist() == [ANYONE, NAMES.index("ball")]


def test_stills_of_matches_left_out_are_not_read(tmp_path: Path) -> None:
    match_of_stills(tmp_path, "aa_1", "aa_2", "bb_1")

    assert [f.stem for f in stills(tmp_path, without=("aa",)).files] == ["bb_1"]
    assert [f.stem for f in stills(tmp_path, only=("aa",)).files] == ["aa_1", "aa_2"]
    with pytest.raises(DriverError, match="expected pictures beside those left out, got none"):
        stills(tmp_path, without=("aa", "bb"))


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("2 0.5 0.5 0.1", r"aa_1\.txt:5: expected a class number and four shares of 0\.\.1"),
        ("2 0.5 0.5 0.1 nan", r"aa_1\.txt:5: expected a class number"),
        ("two 0.5 0.5 0.1 0.1", r"aa_1\.txt:5: expected a class number"),
        ("7 0.5 0.5 0.1 0.1", r"aa_1\.txt: expected a class of data\.yaml, 0, 1, 2, 3, got 7"),
    ],
)
def test_a_malformed_label_is_refused_with_file_and_line(
    tmp_path: Path, line: str, sentence: str
) -> None:
    folder = stills(match_of_stills(tmp_path, "aa_1"))
    with (tmp_path / "labels" / "aa_1.txt").open("a") as file:
        file.write(line + "\n")

    with pytest.raises(DriverError, match=sentence):
        folder.rows(folder.files[0])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "names: [ball, horse]\n",
            r"data\.yaml:1: names\.1: expected one of player, .* got 'horse'",
        ),
        ("names: []\n", r"data\.yaml:1: names: expected a list of classes"),
        ("path: .\n", r"data\.yaml:1: names: expected a list of classes"),
        ("- ball\n", r"data\.yaml:1: expected a mapping"),
    ],
)
def test_names_of_another_kind_are_refused(tmp_path: Path, text: str, sentence: str) -> None:
    match_of_stills(tmp_path, "aa_1")
    (tmp_path / "data.yaml").write_text(text)

    with pytest.raises(FoveaError, match=sentence):
        stills(tmp_path)
