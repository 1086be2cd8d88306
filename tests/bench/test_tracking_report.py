"""What the report of an evaluation tells."""

from dataclasses import replace

import pytest

from bench.tracking.cases import Case
from bench.tracking.episode import Rules
from bench.tracking.report import paired


def test_what_differs_in_one_thing_is_paired_and_what_does_not_plan() -> None:
    late, hold = Rules(delay=13), Rules(prediction=False)
    rows = {
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
    iou = dict(zip(rows, (0.5, 0.4, 0.6, 0.5, 0.3, 0.2), strict=True))

    def unit(case: str, kind: str, budget: str, value: float) -> dict[str, object]:
        told = {"iou": [value] * 2, "kept": [True] * 2, "shown": [1.0] * 2, "state": ["seen"] * 2}
        episodes = [{"start": 0, **told}]
        return {"clip": "c", "case": case, "kind": kind, "budget": budget, "episodes": episodes}

    units = [
        unit(case, kind, budget, value)
        for case, value in iou.items()
        for kind in ("player", "referee")
        for budget in ("1/8", "1/16")
    ]
    units.append(unit("full", "player", "1", 0.7))

    found = paired(units, list(rows.values()), seed=0)

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
