"""The ball of a real corner kick among a detector's candidates."""

import pytest

from bench import ball_candidates
from tests.shared_data import Footage


@pytest.mark.footage
def test_a_ball_at_a_corner_flag_is_among_the_best_three(footage: Footage) -> None:
    sequence = footage.data("soccernet/SNMOT-116a")

    found = {
        name: ball_candidates.candidates(sequence, name, scale=0.25, every=4, input_px=(736, 416))
        for name in ("eight_bits", "corners")
    }

    shares = {name: report["among"]["still"]["share"] for name, report in found.items()}
    assert shares["corners"] > 0.75  # .906 of all 160 frames
    assert shares["corners"] > shares["eight_bits"] + 0.1  # .637
