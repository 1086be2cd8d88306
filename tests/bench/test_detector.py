"""A detector's figures on labelled pictures, over a network whose answers are known."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

from bench import detector
from tests.operators.networks import constant_network

# person at 40..80, 20..60 of a picture of 160x120, found at .9 and, elsewhere, once more at .5
PERSON, ELSEWHERE = (10.0, 5.0, 20.0, 15.0), (30.0, 20.0, 38.0, 28.0)  # at a quarter
LABEL = "2 0.375 0.333333 0.25 0.333333"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two labelled pictures: a person in the first, nothing in the second."""
    for name in ("images", "labels"):
        (tmp_path / "halls" / name).mkdir(parents=True)
    for name, label in (("a", f"{LABEL}\n\n"), ("b", "")):
        picture = np.full((120, 160, 3), 90, np.uint8)
        cv2.imwrite(str(tmp_path / "halls" / "images" / f"{name}.png"), picture)
        (tmp_path / "halls" / "labels" / f"{name}.txt").write_text(label)
    return tmp_path / "halls"


@pytest.fixture
def weights(tmp_path: Path) -> str:
    rows = np.zeros((1, 300, 6), np.float32)
    rows[0, 0], rows[0, 1] = (*PERSON, 0.9, 0), (*ELSEWHERE, 0.5, 0)
    return constant_network(
        tmp_path / "n.onnx", rows, size_px=(40, 30), names="['person', 'cup']",
        confidence="{'person': 0.6}",
    )  # fmt: skip


def run(*words: str) -> Result:
    return CliRunner().invoke(detector.main, words)


def test_precision_recall_and_time_are_reported(folder: Path, weights: str, tmp_path: Path) -> None:
    path = tmp_path / "figures.json"

    done = run(
        str(folder), "--classes", "2=person,0=cup", "--weights", weights, "--json", str(path)
    )

    assert done.exit_code == 0, done.output
    report: dict[str, Any] = json.loads(path.read_text())
    assert (report["pictures"], report["data"], report["weights"]) == (2, "halls", "n.onnx")
    person, cup = report["classes"]
    # at .6 the person is found in the first picture, and one that is not there in the second
    assert (person["present"], person["confidence"]) == (1, 0.6)
    assert (person["precision"], person["recall"]) == (0.5, 1.0)
    assert (cup["present"], cup["recall"], cup["average_precision"]) == (0, 0.0, 0.0)
    assert 0 < report["ms"]["p05"] <= report["ms"]["median"] <= report["ms"]["p95"]


@pytest.mark.parametrize(
    ("classes", "label", "sentence"),
    [
        ("person", LABEL, "classes: expected NUMBER=NAME, got 'person'"),
        ("2=persn", LABEL, "classes: expected one of person, cup, got 'persn'"),
        ("2=person", "2 0.5 0.5 0.1", "a.txt:1: expected a class number and four shares of 0..1"),
        ("2=person", "\n2 0.5 0.5 0.1 1.5", "a.txt:2: expected a class number and four shares"),
        ("2=person", "2.5 0.5 0.5 0.1 0.1", "a.txt:1: expected a class number and four shares"),
        ("2=person", "nan 0.5 0.5 0.1 0.1", "a.txt:1: expected a class number and four shares"),
        ("2=person", "a dog", "a.txt:1: expected a class number and four shares"),
    ],
)
def test_what_is_wrong_is_one_sentence(
    folder: Path, weights: str, classes: str, label: str, sentence: str
) -> None:
    (folder / "labels" / "a.txt").write_text(label)

    done = run(str(folder), "--classes", classes, "--weights", weights)

    assert done.exit_code == 1
    assert sentence in done.output


def test_a_folder_without_labelled_pictures_is_refused(tmp_path: Path, weights: str) -> None:
    done = run(str(tmp_path), "--classes", "0=person", "--weights", weights)

    assert done.exit_code == 1
    assert "expected images/ and labels/" in done.output


@pytest.fixture
def match(tmp_path: Path) -> Path:
    """Stills of a match for testing and of one for development, each with a player and a ball."""
    folder = tmp_path / "matches"
    (folder / "images").mkdir(parents=True)
    (folder / "labels").mkdir()
    (folder / "data.yaml").write_text("names: [ball, goalkeeper, player, referee]\n")
    for name in ("798b45_0_1", "744b27_0_1", "08fd33_0_1", "121364_0_1"):
        cv2.imwrite(str(folder / "images" / f"{name}.png"), np.full((120, 160, 3), 90, np.uint8))
        rows = ("2 0.375 0.333333 0.25 0.333333", "0 0.8 0.8 0.02 0.03")
        (folder / "labels" / f"{name}.txt").write_text("\n".join(rows))
    return folder


@pytest.fixture
def soccer_weights(tmp_path: Path) -> str:
    """It finds the player at .9, and the ball third best, at .3, three pixels off."""
    rows = np.zeros((1, 300, 6), np.float32)
    rows[0, 0] = (*PERSON, 0.9, 0)
    for row, (x, score) in enumerate([(2, 0.5), (8, 0.4), (35, 0.3)]):
        rows[0, row + 1] = (x - 0.5, 23.5, x + 0.5, 24.5, score, 2)
    return constant_network(
        tmp_path / "soccer.onnx", rows, size_px=(40, 30),
        names="['player', 'referee', 'ball']", confidence="{'ball': 0.6}",
    )  # fmt: skip


def test_each_match_of_the_split_has_its_figures(match: Path, soccer_weights: str) -> None:
    path = match / "figures.json"

    done = run(str(match), "--weights", soccer_weights, "--split", "test", "--json", str(path))

    assert done.exit_code == 0, done.output
    report = json.loads(path.read_text())
    assert sorted(report["matches"]) == ["744b27", "798b45"]
    by_name = {row["class"]: row for row in report["classes"]}
    assert (by_name["player"]["present"], by_name["player"]["recall"]) == (2, 1.0)
    assert by_name["referee"]["present"] == 0
    # as a box the ball is missed, as a place it is the third candidate
    assert by_name["ball"]["average_precision"] == 0
    centre = by_name["ball by centre"]
    assert (centre["among_3"], centre["recall"], centre["confidence"]) == (1.0, 0.0, 0.6)


def test_confidences_may_be_chosen_on_other_pictures(match: Path, soccer_weights: str) -> None:
    path = match / "figures.json"
    words = ["--split", "test", "--choose-on", "development", "--json", str(path)]

    done = run(str(match), "--weights", soccer_weights, *words)

    assert done.exit_code == 0, done.output
    report = json.loads(path.read_text())
    assert report["chosen_on"] == "development"
    by_name = {row["class"]: row for row in report["classes"]}
    assert by_name["ball by centre"]["confidence"] == by_name["ball"]["confidence"] == 0.3
    assert by_name["ball by centre"]["recall"] == 1.0


def test_labels_that_know_persons_only_are_scored_by_persons(
    match: Path, soccer_weights: str
) -> None:
    (match / "data.yaml").write_text("names: [sports ball, sports ball, person, person]\n")

    done = run(str(match), "--weights", soccer_weights)

    assert done.exit_code == 0, done.output
    assert "person" in done.output
    assert "referee" not in done.output


def test_a_folder_without_pictures_of_the_split_is_refused(folder: Path, weights: str) -> None:
    done = run(str(folder), "--classes", "2=person", "--weights", weights, "--split", "test")

    assert done.exit_code == 1
    assert "expected pictures of the test split, got none" in done.output
