"""Generated orders and bytes: each is refused in one sentence or done, and the graph runs on."""

import pytest

from bench.fuzz.wire import known
from tests.adversarial.fuzzing import fuzzed

SLOW = pytest.mark.slow


@pytest.mark.lengthy
@pytest.mark.parametrize("count", [120, pytest.param(10_000, marks=SLOW)])
def test_no_order_breaks_a_running_graph(count: int) -> None:
    found = fuzzed("orders", count, seed=2)

    assert found.tally.sound, "\n".join(found.tally.examples)
    assert found.tally.accepted
    assert found.tally.refused > count / 2
    assert found.left == []


@pytest.mark.parametrize("count", [10_000, pytest.param(1_000_000, marks=SLOW)])
def test_no_bytes_break_a_decoder(count: int) -> None:
    found = fuzzed("wire", count, seed=3)

    assert found.tally.sound, "\n".join(found.tally.examples)
    assert found.tally.refused > count / 2
    assert found.left == []


@pytest.mark.parametrize("name", known())
def test_messages_are_valid_before_they_are_altered(name: str) -> None:
    data, read = known()[name]

    read(data)
