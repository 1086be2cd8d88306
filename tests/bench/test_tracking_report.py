"""The report of an evaluation: means, intervals and paired differences."""

from dataclasses import replace
from typing import Any

import pytest

from bench.tracking.cases import Case
from bench.tracking.episode import Rules
from bench.tracking.report import paired, rows


def unit(case: str, kind: str, budget: str, value: float, *starts: int) -> dict[str, Any]:
    told: dict[str, Any] = {"away_px": [3.0] * 2}
    told |= {"iou": [value] * 2, "kept": [True] * 2, "shown": [1.0] * 2, "state": ["free"] * 2}
    counted = {"read_px": 125, "full_px": 1000}
    episodes = [{"start": start, **told, **counted} for start in starts or (0,)]
    return {"clip": "c", "case": case, "kind": kind, "budget": budget, "episodes": episodes}


def test_no_interval_is_claimed_of_one_clip_however_many_starts_it_has() -> None:
    many = [unit("full", "player", "1", 0.2 + 0.5 * (s % 2), s) for s in range(40)]
    more = [
        unit("full", "player", "1", 0.9 - 0.1 * k) | {"clip": name}
        for k, name in enumerate("defgh")
    ]

    (alone,), few, enough = rows(many), rows([*many, *more[:4]]), rows([*many, *more])

    assert (alone["ci95"], alone["clips"]) == (None, 1)
    assert [row["ci95"] for row in few] == [None] * 6
    assert [row["clip"] for row in enough if row["ci95"]] == ["all"]


def test_a_target_that_few_of_several_clips_show_has_no_interval() -> None:
    units = [unit("foveated", "ball", "1/8", 0.5), unit("spatial", "ball", "1/8", 0.4)]
    for k, name in enumerate("cdefgh"):
        units.append(unit("foveated", "player", "1/8", 0.5) | {"clip": name})
        units.append(unit("spatial", "player", "1/8", 0.3 + 0.02 * k) | {"clip": name})
    cases = [Case(strategy=s, budget="1/8", name=s, rules=Rules()) for s in ("foveated", "spatial")]

    found = {row["target"]: row for row in paired(units, cases)}

    assert (found["ball"]["ci95"], found["ball"]["clips"]) == (None, 1)
    low, high = found["player"]["ci95"]
    assert found["player"]["difference"] == pytest.approx(0.15)
    assert 0.05 < low < 0.15 < high < 0.25


def test_a_row_has_the_share_of_the_pixels_that_were_read_and_the_papers_figure() -> None:
    strategies = {"foveated": 0.283, "round_robin": 0.0098, "centred": 0.0048, "exposure": 0.098}
    units = [unit(name, "ball", "1/8", 0.5, 0, 8) for name in strategies]
    units.append(unit("foveated, ROI alone", "ball", "1/8", 0.5))

    found = rows(units)

    whole = {row["strategy"]: row for row in found if row["target"] == "ball"}
    assert {name: row["paper"] for name, row in whole.items()} == {
        **strategies,
        "foveated, ROI alone": 0.283,
    }
    assert {row["pixels"] for row in found} == {0.125}
    assert whole["foveated"]["starts"] == 2


def test_a_policys_row_is_paired_with_other_strategies_and_those_with_one_other_option() -> None:
    late, hold = Rules(delay=13), Rules(prediction=False)
    cases = {
        "foveated": Case(strategy="foveated", budget="1/8", name="foveated", rules=Rules()),
        "late": Case(strategy="foveated", budget="1/8", name="late", rules=late),
        "true": Case(
            strategy="foveated", budget="1/8", name="true", rules=Rules(), replaced=("policy",)
        ),
        "hold": Case(strategy="foveated", budget="1/8", name="hold", rules=hold),
        "late hold": Case(
            strategy="foveated",
            budget="1/8",
            name="late hold",
            rules=replace(late, prediction=False),
        ),
        "spatial": Case(strategy="spatial", budget="1/8", name="spatial", rules=Rules()),
    }
    iou = dict(zip(cases, (0.5, 0.4, 0.6, 0.5, 0.3, 0.2), strict=True))

    units = [
        unit(case, kind, budget, value)
        for case, value in iou.items()
        for kind in ("player", "referee")
        for budget in ("1/8", "1/16")
    ]
    units.append(unit("full", "player", "1", 0.7))

    found = paired(units, list(cases.values()))

    at_eighth = [row for row in found if (row["target"], row["budget"]) == ("player", "1/8")]
    told = {(row["strategy"], row["against"]): row["difference"] for row in at_eighth}
    planned = ("foveated", "late", "true", "hold", "late hold")
    assert told == pytest.approx(
        {
            **{("foveated", other): 0.5 - iou[other] for other in ("late", "true", "hold")},
            ("late", "late hold"): 0.1,
            ("hold", "late hold"): 0.2,
            **{(of, "spatial"): iou[of] - 0.2 for of in planned},
            **{(of, "full"): iou[of] - 0.7 for of in planned},
        }
    )
    assert len(found) == 4 * len(at_eighth) - 2 * len(planned)  # no full row for the referee


def test_a_policys_row_is_paired_with_the_round_robin_whose_plans_come_as_late() -> None:
    cases = [
        Case(strategy=s, budget="1/8", name=f"{s}, delay {d}", rules=Rules(delay=d))
        for s in ("foveated", "round_robin")
        for d in (0, 13)
    ]
    units = [unit(case.name, "player", "1/8", 0.5) for case in cases]

    found = [row for row in paired(units, cases) if row["against"].startswith("round_robin")]

    assert [(row["strategy"], row["against"]) for row in found] == [
        (f"foveated, delay {d}", f"round_robin, delay {d}") for d in (0, 13)
    ]
