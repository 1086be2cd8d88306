"""State that a swap cannot transfer is reported or refused, and the old instance continues."""

import logging
import re
from pathlib import Path

import pytest

from pipeline.cli.results import swap_lines
from pipeline.protocol.orders import SwapOrder
from tests.pipeline.run.test_swap import Results, swapping
from tests.sample_graphs import assert_accounts_add_up, go, plan_of, reasons, swapped

GRAPH = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    settings: {{rate_hz: 60, side_px: 40}}
  work:
    operator: tests.stateful_samples:{cls}
    inputs: {{frame: {{from: ticker.context, depth: 60}}}}
"""


def test_undeclared_state_that_a_swap_loses_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    plan, results = plan_of(tmp_path, GRAPH.format(cls="Forgetful")), Results()
    caplog.set_level(logging.INFO)

    go(plan, 0, swapping(results, SwapOrder(node="work", probation=5)))

    assert reasons(results) == [""]
    assert swapped(results[0]).forgotten == ["recent", "seen"]
    line = swap_lines(swapped(results[0]))[1]
    assert line.startswith("work: begins without what its predecessor kept in recent, seen;")
    assert "state() and taken over by restore()" in line
    assert "forgotten ['recent', 'seen']" in caplog.text


def test_declared_state_and_another_operator_are_no_reason_to_warn(tmp_path: Path) -> None:
    plan, results = plan_of(tmp_path, GRAPH.format(cls="Forgetful")), Results()
    other = SwapOrder(node="work", operator="tests.stateful_samples:Counter", probation=5)

    go(plan, 0, swapping(results, other, SwapOrder(node="work", probation=5)))

    assert reasons(results) == ["", ""]
    assert [swapped(r).forgotten for r in results] == [[], []]
    assert [len(swap_lines(swapped(r))) for r in results] == [1, 1]
    assert [swapped(r).state for r in results] == ["none", "carried over"]


def test_a_swap_without_the_old_state_is_asked_for(tmp_path: Path) -> None:
    plan, results = plan_of(tmp_path, GRAPH.format(cls="Unnamed")), Results()
    orders = [
        SwapOrder(node="work", probation=5),
        SwapOrder(node="work", probation=5, fresh=True, shadow=5),
    ]

    report = go(plan, 0, swapping(results, *orders))

    refused, done = reasons(results)
    assert refused.endswith("; `fovea swap --fresh` begins without it; the old instance continues")
    assert done == ""
    assert swapped(results[1]).state == "begins anew, as asked"
    assert swapped(results[1]).forgotten == []
    assert_accounts_add_up(report)


def test_a_part_that_has_to_be_stopped_and_started_begins_anew_with_a_reason(
    tmp_path: Path,
) -> None:
    counter = GRAPH.format(cls="Counter").replace("  work:\n", "  work:\n    group: hand\n")
    beside = (
        "  beside:\n    group: hand\n    operator: tests.samples:Pass\n    inputs: {frame: work}\n"
    )
    plan, results = plan_of(tmp_path, counter + beside), Results()

    go(plan, 0, swapping(results, SwapOrder(node="work", probation=5)))

    assert reasons(results) == [""]
    assert not swapped(results[0]).hot
    assert swapped(results[0]).state == "begins anew: it was stopped and started"
    lines = swap_lines(swapped(results[0]), shadow=100)
    assert "begins anew: it was stopped and started" in lines[0]
    assert lines[-1].startswith("shadow: none: ")


KEPT_BACK = {
    "Unnamed": r"the state cannot be carried over: its state\(\) names no dataclass",
    "Refusing": r"its restore\(\) failed: .*stateful_samples\.py:\d+: ValueError:",
    "Mistaken": "the running instance's state cannot be written: Counted.count: expected int, got",
    "Loose": "the running instance's state cannot be written: dict: expected a dataclass",
}


@pytest.mark.lengthy
def test_a_state_that_cannot_be_carried_over_leaves_the_old_part_at_work(tmp_path: Path) -> None:
    text = "nodes:\n" + GRAPH.partition("nodes:\n")[2].partition("  work:")[0].format()
    for cls in KEPT_BACK:
        part = GRAPH[GRAPH.index("  work:") :].format(cls=cls)
        text += part.replace("  work:", f"  {cls.lower()}:")
    plan, results = plan_of(tmp_path, text), Results()
    orders = [SwapOrder(node=cls.lower(), probation=5) for cls in KEPT_BACK]

    report = go(plan, 0, swapping(results, *orders))

    for (cls, said), reason in zip(KEPT_BACK.items(), reasons(results), strict=True):
        assert re.match(f"{cls.lower()}: {said}", reason)
        assert "; `fovea swap --fresh` begins without it" in reason
        assert "\n" not in reason
    assert_accounts_add_up(report)
    assert all(edge["dropped"] == {} for edge in report["edges"])
    assert report["restarts"] == {}
