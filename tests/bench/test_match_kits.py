"""Referees are told by what people wear at full resolution, compared over a match."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy.special import logit

from bench.ball_candidates import labelled
from bench.match_kits import (
    ALL,
    LEFT_OUT,
    OF_MATCH,
    RARE,
    SAME_SHORTS,
    WAYS,
    Looked,
    by_kits_alone,
    judged,
    known_by,
    looked,
    main,
    of_match,
    signs,
    sure,
    with_kits,
)
from bench.referee_looks import LEAST, ROI, People, PeopleLooks, fitted
from drivers.scenes.soccer import SoccerScene

Floats = NDArray[np.float64]
WHITE, BLACK, LEGS = [240, 128, 128], [40, 128, 128], [170, 140, 145]
PLAYER, KEEPER, REFEREE, COACH = range(4)
PICTURES = 12


def somebody(kind: int, shirt: list[int], rng: np.random.Generator) -> Floats:
    """Return torso, shorts and knees."""
    shorts = BLACK if kind in (REFEREE, COACH) else WHITE
    worn = np.array([shirt, shorts, BLACK if kind == COACH else LEGS], np.float64)
    return worn + rng.normal(0, 3, (3, 3))


def match(seed: int, *, coach: bool = False, pictures: int = PICTURES) -> list[Looked]:
    """Return a match with teams, referees and goalkeepers in kits of its own.

    Each picture has eight of each team, two referees, and every fourth one a goalkeeper in a shirt
    that nobody else wears. Whose shirt is which differs from match to match.
    """
    rng = np.random.default_rng(seed)
    shirts = rng.permutation([[90, a, b] for a in (80, 130, 180) for b in (80, 130, 180)])
    found = []
    for k in range(pictures):
        there = [(PLAYER, 0)] * 8 + [(PLAYER, 1)] * 8 + [(REFEREE, 2)] * 2
        there += [(KEEPER, 3)] * (k % 4 == 0) + [(COACH, 2)] * (coach and k < 3)
        kinds = np.array([kind for kind, _ in there])
        worn = np.stack([somebody(kind, shirts[shirt], rng) for kind, shirt in there])
        boxes = np.array([[30 * i, 0, 30 * i + 10, 30] for i in range(len(there))], np.float32)
        people = People(
            boxes=boxes, shown=boxes, worn=worn[:, :2],
            known=rng.normal(size=(len(there), 6)) + np.array([2, 2, 0, 0, 0, 0]),
            referees=boxes[kinds == REFEREE],
        )  # fmt: skip
        found.append(Looked(people=people, worn=worn))
    return found


def kit_weights(*seeds: int) -> Floats:
    people = [of for seed in seeds for m in [match(seed)] for of in known_by(m, of_match(m))]
    return fitted(people, range(7), in_roi=True)


def test_kits_compared_over_a_match_tell_referees_whose_kit_no_other_match_has() -> None:
    rows = {
        (r["kits of"], r["compared with"]): r
        for r in by_kits_alone([match(seed) for seed in range(4)], 0.85)
    }

    assert {r["present"] for r in rows.values()} == {4 * PICTURES * 2}
    assert rows["a look", "the match"]["recall at 0.85"] > 0.95
    assert rows["a look, with knees", "the match"]["recall at 0.85"] > 0.95


def test_a_goalkeepers_kit_is_in_few_pictures_and_a_referees_in_all() -> None:
    people = match(1)
    share = 3  # column: of the pictures, that in which somebody wears such a kit

    found = signs([of.people for of in people], [of.worn for of in people])

    assert found[0][16:18, share] == pytest.approx(1)
    assert found[0][18, share] <= 0.25
    many = np.exp(found[0][:, 0])
    assert many[0] > many[16] > many[18]


def test_within_a_picture_nobody_is_compared_with_their_own_kit() -> None:
    (first, *_) = match(2)

    (found,) = signs([first.people], [first.worn], within=True)

    assert found[18, 3] == 0  # the goalkeeper's kit is nobody else's there
    assert found[16, 3] == 1  # the referees are two
    assert np.exp(found[18, 0]) < np.exp(found[16, 0]) < np.exp(found[0, 0])


def test_each_sign_is_what_it_is_said_to_be() -> None:
    one = match(5, pictures=2)
    alone = [
        replace(of.people, boxes=of.people.boxes[:1], known=np.full((1, 6), 3.0)) for of in one
    ]
    shirt, shorts = [120.0, 128, 128], [200.0, 128, 128]
    worn = [np.array([[shirt, shorts]]), np.array([[shirt, [200, 128, 128 + SAME_SHORTS]]])]

    (first, _) = signs(alone, worn)

    many = np.log(np.exp(-1) + RARE)
    assert first[0].tolist() == pytest.approx([many, many**2, np.log(1 + RARE), 0, 4])
    worn[1][0, 1, 2] = 128 + 0.9 * SAME_SHORTS  # exp(-.81) is above ALIKE
    assert signs(alone, worn)[0][0, 3] == 1


def test_only_those_whom_the_context_is_sure_of_are_compared_with() -> None:
    people = match(3, pictures=3)
    faint = [replace(of.people, known=of.people.known - 20) for of in people]

    assert not any(sure(of).any() for of in faint)
    (found, *_) = signs(faint, [of.worn for of in people])
    assert found[:, 3].tolist() == [0] * len(found)


def test_a_coach_in_the_kit_of_referees_is_told_by_the_knees() -> None:
    weights = kit_weights(0, 1, 2)
    shown = match(9, coach=True)

    first = with_kits(shown, weights)[0].known[:, list(OF_MATCH)]
    coaches = of_match(shown)[0][-1]

    assert first[16:18, 1].min() > 0
    assert coaches[-2:].tolist() == pytest.approx([0, 0], abs=0.5)
    assert of_match(shown)[0][16, -2] > 2  # legs are brighter than black shorts


def test_where_the_roi_shows_nobody_is_known() -> None:
    (first, *rest) = match(4)
    known = first.people.known.copy()
    known[0, list(ROI)] = logit(LEAST)
    people = [replace(first, people=replace(first.people, known=known)), *rest]

    added = with_kits(people, kit_weights(0, 1))[0].known[:, list(OF_MATCH)]

    assert added[:, 2].tolist() == [1] + [0] * (len(added) - 1)
    assert (added[:, 0] <= 0).all()
    assert (added[:, 1] >= 0).all()
    assert ((added[:, 0] == 0) != (added[:, 1] == 0)).all()


def test_a_match_is_judged_by_the_confidence_of_the_others() -> None:
    weights = kit_weights(0, 1)
    people = {name: with_kits(match(k), weights) for k, name in enumerate("abc", 5)}
    by_match, by_look = WAYS["a look and kits of the match"], WAYS["a look"]

    rows = {r["data"]: r for r in judged(people, ["b", "c"], by_match, 0.85, 0.9)}
    without = {r["data"]: r for r in judged(people, ["b", "c"], by_look, 0.85, 0.9)}

    assert list(rows) == ["a", "b", "c", LEFT_OUT, ALL]
    assert [rows[n]["present"] for n in rows] == [24, 24, 24, 48, 72]
    assert rows[ALL]["precision"] > 0.85
    assert rows[ALL]["recall"] > 0.9
    assert rows[LEFT_OUT]["recall"] == pytest.approx(
        (rows["b"]["recall"] + rows["c"]["recall"]) / 2, abs=1e-3
    )
    assert without[ALL]["recall"] < 0.2  # what the ROI said is noise here

    # a match without referees: at the confidence of the others every find is false
    people["a"] = [replace(of, referees=of.referees[:0]) for of in people["a"]]
    (first, *_) = judged(people, ["b", "c"], by_match, 0.85, 0.9)
    assert (first["data"], first["precision"]) == ("a", 0)


def test_a_confidence_that_the_others_never_have_finds_nobody() -> None:
    people = {name: with_kits(match(k, pictures=2), np.zeros(8)) for k, name in enumerate("ab")}
    nobody = {n: [replace(of, referees=of.referees[:0]) for of in m] for n, m in people.items()}

    rows = list(judged(nobody, ["b"], ROI, 0.85, 0.9))

    assert [(r["precision"], r["recall"]) for r in rows] == [(None, 0)] * 4


def test_kits_of_a_drawn_picture_are_those_of_full_resolution() -> None:
    source = SoccerScene(size_px=(1920, 1080), rate_hz=30, seed=52_000)

    found = looked(PeopleLooks("", (0, 0)), labelled(source, 0, source.truth(0)))

    assert found.worn.shape == (len(found.people.boxes), 3, 3)
    rows = sure(found.people)
    assert rows.any()
    assert not np.array_equal(found.worn[rows, :2], found.people.worn[rows])


def test_a_folder_without_a_description_is_told_in_a_sentence(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["new=eight_bits", "--football", str(tmp_path)])

    assert result.exit_code
    assert "expected" in result.output
