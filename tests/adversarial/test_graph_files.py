"""Generated graph files: each loads or is refused in one sentence, and nothing is written."""

import pytest

from tests.adversarial.fuzzing import fuzzed

MANY = 10_000


@pytest.mark.parametrize("count", [300, pytest.param(MANY, marks=pytest.mark.slow)])
def test_no_file_makes_the_loader_break_hang_or_write(count: int) -> None:
    found = fuzzed("graphs", count, seed=1)

    assert found.tally.sound, "\n".join(found.tally.examples)
    assert found.tally.accepted
    assert found.tally.refused > count / 2
    assert found.left == []
