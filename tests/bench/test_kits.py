"""The weights of kits are fitted to what they shall tell, and scored by class."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.kits import Scene, fitted, judged, rows_of, scene, scored
from bench.logistic import regressed
from operators.saliency.example import NAMES
from operators.training.stills import Labelled
from pipeline.errors import RunError

RED, WHITE, YELLOW, BLACK = (200, 30, 40), (235, 235, 235), (230, 220, 20), (20, 20, 20)
Found = Mapping[str, tuple[NDArray[np.float32], NDArray[np.float32]]]


def pair(rng: np.random.Generator) -> tuple[Labelled, Found]:
    """A lawn with two teams and a referee, all of whom are found as players, some twice."""
    picture = np.full((60, 300, 3), (60, 130, 50), np.uint8)
    boxes = []
    for k, (shirt, shorts) in enumerate(
        [(RED, WHITE)] * 5 + [(WHITE, WHITE)] * 5 + [(YELLOW, BLACK)]
    ):
        left, top = 5 + 26 * k, int(rng.integers(5, 35))
        picture[top + 3 : top + 10, left : left + 8] = shirt
        picture[top + 10 : top + 14, left : left + 8] = shorts
        boxes.append([left, top, left + 8, top + 20])
    truth = np.array(boxes, np.float32)
    numbers = np.array([NAMES.index("player")] * 10 + [NAMES.index("referee")])
    scores = rng.uniform(0.5, 0.9, 11).astype(np.float32)
    order = np.argsort(-scores)
    nothing = (np.zeros((0, 4), np.float32), np.zeros(0, np.float32))
    found = {"player": (truth[order], scores[order]), "referee": nothing, "ball": nothing}
    return Labelled(picture=picture, boxes=truth, numbers=numbers), found


def scenes(count: int, seed: int) -> list[Scene]:
    rng = np.random.default_rng(seed)
    return [scene(*pair(rng)) for _ in range(count)]


def test_a_regression_finds_what_made_the_outcome() -> None:
    rng = np.random.default_rng(3)
    inputs = rng.normal(size=(4000, 2)) * (1, 5) + (0, 20)
    chance = 1 / (1 + np.exp(-(2 * inputs[:, 0] - 0.3 * (inputs[:, 1] - 20) - 0.5)))

    weights = regressed(inputs, rng.random(4000) < chance, 0.0)

    assert weights == pytest.approx([2, -0.3, 5.5], abs=0.4)


def test_weights_that_were_fitted_tell_referees_of_other_pictures() -> None:
    of_kits, weights = fitted(scenes(8, 1), scenes(8, 2), 0.85)
    other = scenes(8, 3)

    alone = scored(other, [of.reported for of in other])
    found = judged(other, of_kits, weights)

    assert alone["referee"]["recall"] == 0
    assert alone["player"] == {"present": 80, "precision": pytest.approx(0.909), "recall": 1}
    assert found["referee"] == {"present": 8, "precision": 1, "recall": 1}
    assert found["player"] == {"present": 80, "precision": 1, "recall": 1}


def test_a_precision_that_nobody_reaches_is_an_error() -> None:
    same = [replace(of, worn=np.zeros_like(of.worn)) for of in scenes(4, 5)]

    with pytest.raises(RunError, match="precision: expected one that referees reach, got 1"):
        fitted(same, same, 1.0)


def test_each_data_set_has_rows_without_and_with_kits() -> None:
    weights = np.zeros(6), np.array([0, 0, 0, 0, -1.0])

    rows = list(rows_of("new", {"some": scenes(2, 4)}, *weights))

    assert [(r["data"], r["class"], r["by"]) for r in rows] == [
        ("some", "player", "detector alone"), ("some", "referee", "detector alone"),
        ("some", "player", "with kits"), ("some", "referee", "with kits"),
    ]  # fmt: skip
