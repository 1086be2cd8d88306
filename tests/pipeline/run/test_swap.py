"""A node is replaced while its graph runs: no frame is lost and none arrives twice."""

import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from pipeline import RunError
from pipeline.client.find import find
from pipeline.protocol.orders import Refused, Result, SwapOrder
from pipeline.run.inline import InlineRunner
from pipeline.run.report import Report
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import (
    LOOP,
    LOSSLESS,
    account_of,
    assert_accounts_add_up,
    beside,
    edge,
    go,
    handled,
    plan_of,
    reasons,
    send_signal,
    swapped,
    together,
    wait_for,
    wait_for_progress,
)

TALLY = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    group: ends
    settings: {rate_hz: 20, side_px: 120}
  work:
    operator: tests.samples:Tally
    inputs: {frame: {from: ticker.context, depth: 60}}
  recall:
    operator: tests.samples:Recall
    group: ends
    inputs: {percept: {from: work, depth: 60}}
"""
Results = list[Result]
UNHURRIED_MS = 60_000.0  # per frame: a busy machine fails no test but those about the budget


def order(node: str, **words: Any) -> SwapOrder:
    """Return an order for a swap that only the test itself can make fail."""
    return SwapOrder(**{"node": node, "probation": 5, "budget_ms": UNHURRIED_MS, **words})


def swapping(results: Results, *orders: SwapOrder) -> Callable[[Supervisor], None]:
    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, orders[0].node) > 3)
        for count, order in enumerate(orders, len(results) + 1):
            supervisor.control.take(order, results.append)
            wait_for(supervisor, partial(lambda wanted: len(results) >= wanted, count))
        supervisor.finish()

    return during


def exposed(report: Report) -> int:
    frames: int = report["frames"]["exposed"]
    return frames


def test_no_frame_is_lost_and_none_comes_twice(tmp_path: Path) -> None:
    results: Results = []
    orders = [order("work") for _ in range(2)]

    report = go(plan_of(tmp_path, LOSSLESS), 0, swapping(results, *orders))

    assert reasons(results) == ["", ""]
    assert report["summaries"]["count"] == {"seen": list(range(exposed(report))), "torn": 0}
    assert_accounts_add_up(report)
    assert edge(report, "work.frame")["delivered"] == exposed(report)
    assert edge(report, "count.frame")["delivered"] == exposed(report)
    assert report["restarts"] == {}


@pytest.mark.lengthy
def test_at_most_one_frame_is_left_out_where_the_latest_counts(tmp_path: Path) -> None:
    results: Results = []
    orders = [order("work", probation=2) for _ in range(3)]

    text = together(LOOP, "pair", "steer")
    plan = plan_of(tmp_path, text, changes=("ticker.rate_hz=4",))
    report = go(plan, 0, swapping(results, *orders))

    assert reasons(results) == [""] * 3
    for result in map(swapped, results):
        made_meanwhile = 1 + result.answered_ms * 4 / 1000  # and the one that was under way
        assert result.left_out["frame"] <= 1 + made_meanwhile
    assert_accounts_add_up(report)


def test_the_state_is_carried_over_and_the_cut_is_where_it_was_asked_for(tmp_path: Path) -> None:
    results: Results = []
    plan = plan_of(tmp_path, TALLY, changes=("ticker.rate_hz=2",))

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "work") > 0)
        supervisor.control.take(order("work", at=200), results.append)
        wait_for(supervisor, lambda: account_of(supervisor, "work.frame").next_receiver_epoch != 0)
        beside(supervisor, lambda: find(plan.name).configure("ticker", {"rate_hz": 60}))
        wait_for(supervisor, lambda: bool(results))
        supervisor.finish()

    report = go(plan, 0, during)

    assert swapped(results[0]).state == "carried over"
    assert swapped(results[0]).seq == 199
    assert report["summaries"]["recall"]["said"] == [[n, n + 1] for n in range(exposed(report))]


def test_a_shadow_run_reports_how_the_answers_differ(tmp_path: Path) -> None:
    results: Results = []
    orders = [order("work", shadow=15, changes=change) for change in ({}, {"gain": 2})]

    inline = ("ticker.side_px=50",)  # a slot may be reused before a late shadow reads it
    report = go(plan_of(tmp_path, TALLY, changes=inline), 0, swapping(results, *orders))

    shadows = [swapped(result).shadow for result in results]
    assert all(shadow is not None for shadow in shadows)
    found = [(shadow.frames, shadow.identical, shadow.missed) for shadow in shadows if shadow]
    assert found == [(15, 15, 0), (15, 0, 0)]
    same, doubled = (shadow.differences for shadow in shadows if shadow)
    assert "action" not in same
    assert doubled["action"].frames == 15
    assert doubled["action"].most >= 15
    counts = [count for _, count in report["summaries"]["recall"]["said"]]
    cut = swapped(results[1]).seq + 1
    assert counts == [*range(1, cut + 1), *(2 * n for n in range(cut + 1, len(counts) + 1))]
    assert_accounts_add_up(report)


@pytest.mark.lengthy
def test_a_part_that_fails_its_probation_gives_way_to_the_old_one(tmp_path: Path) -> None:
    results: Results = []
    failures = {
        "ValueError: told to crash; the old instance continues": {"crash_at": 0},
        "ms a frame, expected at most 20.0 ms": {"sleep_s": 0.03},
        "finished no frame for 2": {"sleep_s": 60.0},
    }
    # by default the budget follows from the predecessor's times, which a busy machine makes longer
    orders = [
        SwapOrder(node="work", changes=change, budget_ms=20.0) for change in failures.values()
    ]

    report = go(
        plan_of(tmp_path, TALLY, changes=("ticker.rate_hz=10",)), 0, swapping(results, *orders)
    )

    for said, result in zip(failures, results, strict=True):
        assert isinstance(result, Refused)
        assert said in result.reason
        assert result.rolled_back
    assert [seq for seq, _ in report["summaries"]["recall"]["said"]] == list(range(exposed(report)))
    assert edge(report, "work.frame")["delivered"] == exposed(report)
    assert_accounts_add_up(report)
    assert report["restarts"] == {}


def test_a_part_that_dies_while_its_successor_gets_ready_is_started_again(
    tmp_path: Path,
) -> None:
    results: Results = []
    slow = SwapOrder(
        node="work", operator="tests.faulty_samples:Sick", changes={"open_s": 1000.0}, defaults=True
    )

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        supervisor.control.take(slow, results.append)
        account = account_of(supervisor, "work.frame")
        wait_for(supervisor, lambda: supervisor.processes["work"].promised > account.reader_epoch)
        send_signal(supervisor, "work", signal.SIGKILL)
        wait_for(supervisor, lambda: bool(results))
        wait_for_progress(supervisor, "work")
        supervisor.finish()

    report = go(plan_of(tmp_path, LOSSLESS), 0, during)

    assert "work: it ended meanwhile and starts again; try again" in reasons(results)[0]
    assert report["restarts"] == {"work": 1}
    assert_accounts_add_up(report)


def test_a_successor_that_is_killed_loses_nothing(tmp_path: Path) -> None:
    results: Results = []

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        old = supervisor.pid("work")
        supervisor.control.take(order("work", probation=1_000_000), results.append)
        wait_for(supervisor, lambda: supervisor.pid("work") != old)
        wait_for_progress(supervisor, "work")
        send_signal(supervisor, "work", signal.SIGKILL)
        wait_for(supervisor, lambda: bool(results))
        assert supervisor.pid("work") == old
        supervisor.finish()

    report = go(plan_of(tmp_path, LOSSLESS), 0, during)

    assert "ended by signal SIGKILL" in reasons(results)[0]
    assert report["summaries"]["count"] == {"seen": list(range(exposed(report))), "torn": 0}
    assert edge(report, "work.frame")["delivered"] == exposed(report)


@pytest.mark.lengthy
def test_a_successor_that_does_not_fit_is_refused_and_the_graph_goes_on(tmp_path: Path) -> None:
    results: Results = []
    refusals = {
        "has no attribute 'Pass2'": {"operator": "tests.samples:Pass2"},
        "work.inputs.frame: tests.samples:Steer has no such input; there is percept": {
            "operator": "tests.samples:Steer"
        },
        "work: expected Frame, tests.samples:Tally sends Percept": {
            "operator": "tests.samples:Tally"
        },
        "expected an operator that answers frames, tests.samples:Ticker makes them": {
            "operator": "tests.samples:Ticker", "defaults": True
        },
        "work.every: must be at least 1, got 0": {"changes": {"every": 0}},
        "work.evry: no such setting, did you mean 'every'?": {"changes": {"evry": 1}},
    }  # fmt: skip
    orders = [SwapOrder(node="work", **words) for words in refusals.values()]  # type: ignore[arg-type]

    report = go(plan_of(tmp_path, LOSSLESS), 0, swapping(results, *orders))

    for said, result in zip(refusals, results, strict=True):
        assert isinstance(result, Refused)
        assert said in result.reason
        assert not result.rolled_back
    assert report["summaries"]["count"]["seen"] == list(range(exposed(report)))
    assert_accounts_add_up(report)


def test_a_swap_of_a_missing_node_is_refused_in_one_sentence(tmp_path: Path) -> None:
    with Supervisor(plan_of(tmp_path, LOSSLESS)) as supervisor:
        with pytest.raises(RunError, match="no node wrk, did you mean 'work'"):
            supervisor.control.take(SwapOrder(node="wrk"), lambda _: None)
        with pytest.raises(RunError, match="work: is not running now"):
            supervisor.control.take(SwapOrder(node="work"), lambda _: None)


@pytest.mark.lengthy
def test_joined_inputs_and_latest_edges_keep_their_accounts(tmp_path: Path) -> None:
    results: Results = []
    orders = [order(node, probation=10) for node in ("pair", "steer", "work")]

    report = go(plan_of(tmp_path, LOOP), 0, swapping(results, *orders))

    assert reasons(results) == ["", "", ""]
    assert_accounts_add_up(report)
    assert edge(report, "steer.percept")["dropped"] == {}
    assert edge(report, "steer.percept")["lost_in_crash"] == 0


def test_in_lockstep_a_swapped_part_changes_no_byte(tmp_path: Path) -> None:
    results: Results = []
    plan = plan_of(tmp_path, together(LOOP, "work", "steer"), clock="lockstep")

    one = go(plan, 0, swapping(results, order("pair")))
    with InlineRunner(plan) as runner:
        for _ in runner.run(exposed(one)):
            pass
        plain = runner.report()

    assert 3 < swapped(results[0]).seq < exposed(one) - 1
    assert one["schedule_sha256"] == plain["schedule_sha256"]


@pytest.mark.lengthy
def test_a_source_or_a_node_that_shares_a_process_is_stopped_and_started(tmp_path: Path) -> None:
    results: Results = []
    text = together(LOOP, "work", "pair", "steer")
    orders = [
        order("work", changes={"every": 2}),
        order("work", changes={"crash_after": 3}, probation=30),
        order("work", changes={"every": 0}),
        order("ticker", changes={"rate_hz": 90}),
    ]

    report = go(plan_of(tmp_path, text), 0, swapping(results, *orders))

    assert all(swapped(r).gap_ms > 0 for r in (results[0], results[3]))
    assert not swapped(results[0]).hot
    assert results[2] == Refused("work.every: must be at least 1, got 0")
    assert "told not to live for long; the old instance was restarted" in reasons(results)[1]
    assert_accounts_add_up(report)
    assert report["failure"] == ""
    assert exposed(report) > 5  # it went on until `finish`


def test_a_part_that_shall_never_restart_is_not_started_by_a_swap_that_failed(
    tmp_path: Path,
) -> None:
    plan = plan_of(tmp_path, LOSSLESS.replace("  work:\n", "  work:\n    restart: never\n"))
    results: Results = []

    with Supervisor(plan) as supervisor:
        supervisor.start()
        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        never = order("work", at=1 << 30)
        supervisor.control.take(never, results.append)
        account = account_of(supervisor, "work.frame")
        wait_for(supervisor, lambda: account.next_receiver_epoch != 0)
        send_signal(supervisor, "work", signal.SIGKILL)
        wait_for(supervisor, lambda: bool(results) and supervisor.pid("work") == 0)
        made = account_of(supervisor, "work.frame").sent
        wait_for(supervisor, lambda: account_of(supervisor, "work.frame").sent > made + 10)

        assert supervisor.pid("work") == 0
        assert supervisor.restarts == {}
