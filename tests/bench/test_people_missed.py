"""People are counted as missed by how much of them is covered, at the best confidence there is."""

from pathlib import Path
from typing import cast

import numpy as np
import pytest
from click.testing import CliRunner

from bench.detector_scoring import Looker
from bench.people_missed import Sightings, assigned, least_confidence, main, of_stills, rows_of
from operators.saliency.example import NAMES
from operators.training.stills import Labelled
from pipeline.errors import SettingsError

PERSON = [0, 0, 10, 20]


def boxes(*given: list[int]) -> np.ndarray:
    return np.array(given, np.float32).reshape(-1, 4)


def scores(*given: float) -> np.ndarray:
    return np.array(given, np.float32)


def test_a_person_is_found_once_by_the_best_detection_that_fits() -> None:
    found = boxes(PERSON, [1, 0, 11, 20], [40, 0, 50, 20])

    right, best = assigned(found, scores(0.9, 0.8, 0.7), boxes(PERSON, [80, 0, 90, 20]))

    assert right.tolist() == [True, False, False]
    assert best.tolist() == pytest.approx([0.9, 0])


def test_the_least_confidence_is_where_the_precision_was_held_last() -> None:
    right = np.array([True, False, True, True, False, False])

    assert least_confidence(scores(0.9, 0.8, 0.7, 0.6, 0.5, 0.4), right, 0.75) == pytest.approx(0.6)
    assert least_confidence(scores(0.9, 0.8), np.array([False, False]), 0.5) is None


def test_nobody_and_nothing_found_is_no_error() -> None:
    sightings = Sightings()
    nothing = (boxes(), scores())

    sightings.add({"player": nothing, "referee": nothing}, "player", boxes(), np.zeros(0, np.bool_))

    assert list(sightings.rows(0.9)) == []


def test_covered_people_have_a_row_of_their_own_and_the_wrong_class_is_told() -> None:
    truth = boxes(PERSON, [5, 0, 15, 20], [50, 0, 60, 20], [80, 0, 90, 20])
    numbers = np.array([NAMES.index(n) for n in ("player", "player", "player", "referee")])
    picture = Labelled(picture=np.zeros((9, 9, 3), np.uint8), boxes=truth, numbers=numbers)
    found = {
        "player": (boxes(PERSON, [50, 0, 60, 20], [80, 0, 90, 20]), scores(0.9, 0.8, 0.3)),
        "referee": (boxes(), scores()),
    }

    rows = list(rows_of(iter([(picture, found)]), {"player": 0.9, "referee": 0.85}))

    told = {(r["class"], r["covered"]): r for r in rows}
    assert told["player", "all"]["confidence"] == 0.8
    assert told["player", "all"]["recall"] == pytest.approx(2 / 3, abs=1e-3)
    assert told["player", "0 to 0.15"]["recall"] == 1
    assert told["player", "0.4 to 1"]["recall"] == 0.5
    assert told["referee", "all"] | {"recall": None, "as anybody": 1} == told["referee", "all"]


def test_labels_of_other_classes_are_refused(tmp_path: Path) -> None:
    (tmp_path / "data.yaml").write_text("names: [player, person]")
    looker = cast("Looker", None)  # refused before any look

    with pytest.raises(SettingsError, match=r"expected classes .*, got person"):
        next(of_stills(tmp_path, looker, "test"))


def test_without_data_it_says_what_is_missing(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["ships=", "--json", str(tmp_path / "x.json")])

    assert result.exit_code == 1
    assert "expected" in result.output
    assert result.output.count("\n") == 1
