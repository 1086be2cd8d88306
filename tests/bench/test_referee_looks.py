"""Referees are told by what the context, kits and a look at full resolution say of them."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.ball_candidates import labelled
from bench.people_missed import PEOPLE
from bench.referee_looks import (
    LEAST,
    People,
    PeopleLooks,
    by_kits,
    by_others,
    fitted,
    fold,
    folds_of,
    main,
    marks,
    rows_of,
)
from drivers.scenes.soccer import SoccerScene
from operators.saliency.example import NAMES
from pipeline.boxes import iou
from pipeline.errors import SettingsError
from tests.operators.training.labelled_stills import match_of_stills

ROI, REFEREE_IN_ROI = (3, 4), 3


def picture(rng: np.random.Generator, told: float = 3.0) -> People:
    """Return ten people found in a picture, of whom only the ROI tells the referee.

    The context has their boxes six pixels too far right.
    """
    boxes = np.array([[40 * k, 0, 40 * k + 10, 30] for k in range(10)], np.float32)
    known = rng.normal(size=(10, 6))
    known[4, REFEREE_IN_ROI] += 2 * told
    known[:, REFEREE_IN_ROI] -= told
    off = boxes + np.array([6, 0, 6, 0], np.float32)
    worn = np.zeros((10, 2, 3))
    return People(boxes=off, shown=boxes, worn=worn, known=known, referees=boxes[4:5])


def pictures(seed: int, told: float = 3.0) -> list[People]:
    rng = np.random.default_rng(seed)
    return [picture(rng, told) for _ in range(40)]


def test_what_tells_a_referee_has_the_gain() -> None:
    weights = fitted(pictures(1), ROI, in_roi=True)

    assert weights[0] > 3 * abs(weights[1])
    odds, right, present = marks(pictures(2), ROI, weights, in_roi=True)
    assert present == 40
    assert (right == (odds > 0)).mean() > 0.97


def test_the_box_of_the_roi_counts_where_it_was_looked_at() -> None:
    people = picture(np.random.default_rng(3))

    assert people.by(ROI, in_roi=False)[0][4, 0] == people.referees[0, 0] + 6
    assert people.by(ROI, in_roi=True)[0][4, 0] == people.referees[0, 0]


def test_two_who_are_one_in_the_roi_count_once() -> None:
    boxes = np.array([[0, 0, 10, 30], [8, 0, 18, 30]], np.float32)
    people = People(
        boxes=boxes, shown=boxes[[0, 0]], worn=np.zeros((2, 2, 3)), known=np.zeros((2, 6)),
        referees=boxes[:1],
    )  # fmt: skip

    assert len(people.by(ROI, in_roi=False)[0]) == 2
    assert len(people.by(ROI, in_roi=True)[0]) == 1


def test_the_confidence_is_that_of_the_development_pictures() -> None:
    data = {"development": pictures(1), "left out": pictures(2, told=1.0)}

    rows = {(r["data"], r["told by"]): r for r in rows_of("new", data, 0.85)}

    assert rows["development", "the ROI"]["precision"] >= 0.85
    other = rows["left out", "the ROI"]
    assert other["precision"] < 0.85
    assert other["recall at 0.85"] < other["recall"] <= other["recall at any"] == 1
    assert rows["left out", "the context"]["recall at any"] == 0  # their boxes are off


def test_each_match_is_told_by_the_others() -> None:
    (row,) = by_others("new", [pictures(1), pictures(2), pictures(3)], 0.85, ["the ROI"])

    assert row["present"] == 120
    assert row["recall at 0.85"] > 0.9
    assert (row["precision"], row["recall"]) == (None, None)  # no confidence was chosen before

    # of a match with one picture all that is known comes from one in which players are told so
    misled = [of for seed in range(3, 11) for of in pictures(seed, told=-3.0)]
    (row,) = by_others("new", [misled, pictures(2)[:1]], 0.5, ["the ROI"])
    assert row["recall at 0.5"] < 0.1


@pytest.mark.parametrize(
    "text", ["", "a", "a=b", "=b,c", "a,=b,c", "a=,c", " =b,c", "a=b, ", "a=b,c,d"]
)
def test_a_fold_has_matches_and_two_files(text: str) -> None:
    with pytest.raises(SettingsError, match=r"^fold: expected MATCH,…=CONTEXT,CLOSER, got"):
        fold(text)


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["aa,aa=b,c"], "expected each match once, got aa"),
        (["aa=b,c", "aa_1=b,c"], "expected each match once, got aa"),
        (["aa=b,c", "bb=b,c"], "expected matches of .* training, got bb"),
    ],
)
def test_no_still_is_in_two_folds_or_in_none(texts: list[str], said: str, tmp_path: Path) -> None:
    folder = match_of_stills(tmp_path, "aa_1", "aa_2")

    assert folds_of(["aa=b,c"], folder) == [(("aa",), "b", "c")]
    with pytest.raises(SettingsError, match=f"^fold: {said}"):
        folds_of(texts, folder)


def test_a_way_that_never_has_the_precision_finds_nobody_at_it() -> None:
    (row,) = (
        r for r in rows_of("new", {"all": pictures(1)}, 0.85) if r["told by"] == "the context"
    )

    assert (row["precision"], row["recall"], row["recall at 0.85"]) == (None, 0, 0)


def test_somebody_faint_is_compared_with_those_who_are_sure() -> None:
    said = np.zeros((9, 2))
    team, referee = [[150, 120, 120], [150, 128, 128]], [[220, 110, 190], [20, 128, 128]]
    worn = np.array([*[team] * 7, referee, team], np.float64)
    sure = np.array([True] * 7 + [False, False])

    odds = by_kits(said, worn, sure)

    assert odds[7] > odds[8] + 1


def test_beside_too_few_kits_count_nothing() -> None:
    said = np.array([[1.0, -2], [-1, 2]])
    red, yellow = np.full((2, 3), 100.0), np.full((2, 3), 200.0)
    sure = np.array([True, False])

    odds = by_kits(said, np.array([red, yellow]), sure)

    assert odds.tolist() == by_kits(said, np.array([red, red]), sure).tolist()
    assert odds[0] > odds[1]  # the detector's word does


def test_people_of_a_drawn_picture_are_found_and_looked_at() -> None:
    source = SoccerScene(size_px=(1920, 1080), rate_hz=30, seed=52_000)
    whole = labelled(source, 0, source.truth(0))
    everybody = whole.boxes[np.isin(whole.numbers, [NAMES.index(name) for name in PEOPLE])]

    people = PeopleLooks("", (0, 0)).people(whole)

    true = iou(people.boxes, everybody).max(1) > 0.5
    assert true.sum() >= len(everybody) / 2
    assert people.known.shape == (len(people.boxes), 6)
    assert np.median(people.known[true, 3:5].max(1)) > 0
    assert (people.known[:, 3:5].max(1)[~true] < 0).any()
    by_context, by_roi = (iou(b[true], everybody).max(1) for b in (people.boxes, people.shown))
    assert np.median(by_roi) > np.median(by_context)


def test_a_look_at_nobody_is_told_as_the_least_there_is() -> None:
    lawn = np.full((1080, 1920, 3), (60, 130, 50), np.uint8)
    box = np.array([900, 500, 930, 580], np.float32)

    shown, known = PeopleLooks("", (0, 0)).look(lawn, box)

    assert shown.tolist() == box.tolist()
    assert known[:2] == pytest.approx([np.log(LEAST / (1 - LEAST))] * 2)


def test_a_folder_without_a_description_is_told_in_a_sentence(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["new=eight_bits", "--football", str(tmp_path)])

    assert result.exit_code
    assert "data.yaml" in result.output
