"""What is recorded of the drawn scene is computed again, and the same light shows other budgets."""

from pathlib import Path

import pytest

from bench.replays import TRIES, again, laid, on_one_light


@pytest.mark.lengthy
def test_what_is_recorded_is_computed_again_bit_for_bit(tmp_path: Path) -> None:
    row = again(laid("capture.seed=5"), 6, tmp_path / "seen.mcap")

    assert row["frames"] == 6
    assert row["compared"] >= 6 * 5  # what the operators between the source and the score send
    assert row["different"] == 0
    assert not list(tmp_path.iterdir())


@pytest.mark.lengthy
def test_a_smaller_budget_on_the_same_light_reads_fewer_pixels(tmp_path: Path) -> None:
    tries = on_one_light(6, tmp_path / "light.mcap")

    read = [tries[one]["share of the pixels read"] for one in TRIES[:3]]
    assert read == sorted(read, reverse=True)
    assert read[0] > read[2]
