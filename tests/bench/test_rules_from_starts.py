"""Rules of the policies are left out while targets are followed from many starts."""

import numpy as np
import pytest

from bench.rules import ALL, FIGURES
from bench.rules_from_starts import blocks, options_for, rows
from bench.tracking.store import Unit
from pipeline.errors import SettingsError


def unit(clip: str, iou: float, shown: float) -> Unit:
    """Two frames of a start of a ball; `gathered` has the rows of its state, too."""
    episode = {
        "start": 0, "iou": [iou, iou], "away_px": [1.0, 1.0], "kept": [True, True],
        "shown": [shown, shown], "state": ["still", "still"], "read_px": 1, "full_px": 16,
    }  # fmt: skip
    return {
        "clip": clip, "case": "foveated", "budget": "1/16", "target": 1, "kind": "ball",
        "episodes": [episode],
    }  # fmt: skip


def test_what_is_lost_without_a_rule_is_paired_by_clip() -> None:
    usual = blocks([unit(str(k), 0.8, 1.0) for k in range(6)])
    worse = blocks([unit(str(k), 0.4, 0.5) for k in range(6)])

    found = list(rows("learned", {ALL: usual, "a rule": worse}))

    whole, without = (row for row in found if row["target"] == "ball")
    assert (whole[FIGURES[0]], whole[FIGURES[1]]) == (1.0, 0.8)
    assert (without[FIGURES[0]], without[FIGURES[1]]) == (0.5, 0.4)
    assert without[f"{FIGURES[1]}: gained without"] == "-0.400 (-0.400 .. -0.400)"
    assert (without["clips"], without["starts"], without["n"]) == (6, 6, 12)
    assert np.isclose(usual["ball", "1/16"][FIGURES[1]]["0"].total, 1.6)


def test_options_are_those_of_the_evaluation() -> None:
    options = options_for("pursuit", ["--data", "procedural", "--every", "16"])

    assert (options.data, options.every, options.strategies) == ("procedural", 16, ("pursuit",))
    with pytest.raises(SettingsError, match="clips: must be at least 1"):
        options_for("learned", ["--data", "procedural", "--clips", "0"])
