"""A graph before and after what `fovea tune` proposes."""

import pytest
from rich.console import Console

from bench.options import ROOT
from bench.tuned import compared


@pytest.mark.lengthy
def test_both_are_run_and_each_figure_has_a_ratio_in_pairs() -> None:
    changes = ("policy.threads=1",)

    row = compared(ROOT / "graphs/tracking.yaml", (), changes, 20, 1, Console(quiet=True))

    assert set(row) >= {"p50 ms before", "p50 ms after", "p50 ms ratio", "dropped before"}
    assert 0.2 < float(row["cpu percent ratio"].split()[0]) < 5
