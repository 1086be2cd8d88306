"""Generated malformed graph files: each is a plan or one sentence, in bounded time, and no more."""

from pathlib import Path

import pytest

from bench.fuzz.graphs import fuzz_graphs
from tests.sample_graphs import CHAIN, LOOP

MANY = 10_000


@pytest.mark.parametrize("count", [300, pytest.param(MANY, marks=pytest.mark.slow)])
def test_no_file_makes_the_loader_break_hang_or_write(tmp_path: Path, count: int) -> None:
    seeds = []
    for name, text in (("loop", LOOP), ("chain", CHAIN)):
        seeds.append(tmp_path / f"{name}.yaml")
        seeds[-1].write_text(f"name: {name}\n{text}")
    folder = tmp_path / "alone"
    folder.mkdir()

    tally = fuzz_graphs(seeds, count, folder, seed=1)

    assert tally.sound, "\n".join(tally.examples)
    assert tally.accepted
    assert tally.refused > count / 2
