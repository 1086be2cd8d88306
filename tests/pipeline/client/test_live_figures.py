"""Between two looks: rates of edges, processor time of processes, the loop beside its budget."""

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from pipeline.cli.tables import loop_lines, top_tables
from pipeline.client.graph_client import Status
from pipeline.client.live_figures import Loop, live_figures
from pipeline.protocol.fleet import EdgeState, NodeState, Process, State

NONE = {"p50": 0.0, "p99": 0.0}
LOOP = {"p50": 20.0, "p99": 80.0}


def status(
    sent: int = 0, cpu_s: float = 0.0, pid: int = 7, host: str = "", **values: Any
) -> Status:
    node = NodeState(
        name="aim", condition="waiting", epoch=1, handled=sent, last_seq=sent, handler_ms=NONE,
        hop_ms=NONE, loop_ms=values.get("loop_ms", LOOP),
    )  # fmt: skip
    account = {
        "offered": sent, "delivered": sent, "dropped": {}, "lost_in_crash": 0, "in_flight": 0,
    }  # fmt: skip
    edge = EdgeState(
        origin="aim", end="eye.schedule", account=account, age_ms=NONE, age_error_ms=0.0,
        broken=False, sent=sent,
    )  # fmt: skip
    state = State(
        graph="g", label=host, at_ns=0, phase="running", failure="", hosts=(), network_bytes={},
        processes=(Process("aim", ("aim",), pid, cpu_s, 90.0, 2, 1),), nodes=(node,), edges=(edge,),
    )  # fmt: skip
    return Status(graph="g", hosts={host: (state,)}, nodes={"aim": host})


@given(st.integers(0, 10_000), st.integers(0, 10_000), st.floats(0.1, 10), st.floats(0, 50))
def test_rates_and_processor_time_are_those_of_the_time_between(
    before: int, more: int, seconds: float, busy_s: float
) -> None:
    found = live_figures(status(before, 3.0), status(before + more, 3.0 + busy_s), seconds)

    assert found.edge_hz["eye.schedule"] == pytest.approx(more / seconds)
    assert found.cpu_percent["aim"] == pytest.approx(100 * busy_s / seconds, abs=1e-6)
    assert found.loop is not None
    assert found.loop.latency_ms == LOOP
    if more:
        assert found.loop.budget_ms["p99"] == pytest.approx(2 * 1000 * seconds / more)
    else:
        assert found.loop.budget_ms == {}


def test_a_process_that_was_restarted_has_no_processor_time_yet() -> None:
    found = live_figures(status(5, 9.0, pid=7), status(6, 0.2, pid=8), 1.0)

    assert found.cpu_percent == {}


def test_a_graph_without_a_command_has_no_loop() -> None:
    assert live_figures(status(1), status(2, loop_ms=NONE), 1.0).loop is None


def test_names_on_several_hosts_begin_with_the_host() -> None:
    found = live_figures(status(1, host="desk"), status(2, host="desk"), 1.0)

    assert list(found.edge_hz) == ["desk/eye.schedule"]
    assert msgspec.json.encode(found)  # as `fovea top --json` writes it


def test_the_bar_is_as_long_as_the_share_of_the_budget_and_red_above_it() -> None:
    lines = loop_lines(Loop(latency_ms=LOOP, budget_ms={"p50": 40.0, "p99": 66.0}))

    assert [line.plain.count("█") for line in lines] == [15, 30]
    assert [span.style for line in lines for span in line.spans if span.style] == ["green", "red"]
    assert "over its budget" in lines[1].plain
    assert "over its budget" not in lines[0].plain


def test_the_table_has_each_process_with_its_cost() -> None:
    console = Console(width=120)
    with console.capture() as caught:
        console.print(top_tables(status(0, 1.0), status(30, 1.5), 1.0))

    row = next(line for line in caught.get().splitlines() if line.split()[:2] == ["aim", "aim"])
    assert row.split() == ["aim", "aim", "50", "90", "2", "1"]
