"""Generated orders and bytes: each is refused in one sentence or done, and the graph goes on."""

from pathlib import Path

import pytest

from bench.fuzz.orders import fuzz_orders
from bench.fuzz.wire import fuzz_wire, known

SLOW = pytest.mark.slow


@pytest.mark.parametrize("count", [120, pytest.param(10_000, marks=SLOW)])
def test_no_order_breaks_a_graph_that_runs(tmp_path: Path, count: int) -> None:
    tally = fuzz_orders(count, tmp_path, seed=2)

    assert tally.sound, "\n".join(tally.examples)
    assert tally.accepted
    assert tally.refused > count / 2


@pytest.mark.parametrize("count", [10_000, pytest.param(1_000_000, marks=SLOW)])
def test_no_bytes_break_a_decoder(count: int) -> None:
    tally = fuzz_wire(count, seed=3)

    assert tally.sound, "\n".join(tally.examples)
    assert tally.refused > count / 2


@pytest.mark.parametrize("name", known())
def test_what_is_spoilt_was_valid_before(name: str) -> None:
    data, read = known()[name]

    read(data)
