"""A graph is ended by an order as by a signal: with its report, and nothing left behind."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.client.find import find
from pipeline.errors import RunError
from pipeline.protocol.codec import decode, encode
from pipeline.protocol.orders import RESULT, Refused, Result, StopOrder, StopResult, SwapOrder
from pipeline.run.loaded_graph import account_of
from pipeline.run.rundir import running
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import LOSSLESS, beside, handled, plan_of, until, wait_for

SLOW_START = """\
nodes:
  eye:
    operator: tests.faulty_samples:SlowStart
    group: eyes
    settings: {notes: FOLDER/eye}
  other:
    operator: tests.faulty_samples:SlowStart
    group: eyes
    settings: {notes: FOLDER/other}
  see:
    operator: tests.samples:Pass
    inputs: {frame: eye}
"""
FOVEA = (sys.executable, "-m", "pipeline.entry")


def counted(graph: str) -> int:
    """Return how many frames the last node of a graph has handled."""
    health = find(graph).health()["count"]
    return health.handled if health else 0


def test_a_graph_in_the_foreground_ends_with_its_report(tmp_path: Path) -> None:
    plan, report = plan_of(tmp_path, LOSSLESS), tmp_path / "report.json"
    words = ("run", str(tmp_path / "graph.yaml"), "--report", str(report))

    with subprocess.Popen([*FOVEA, *words], stdout=subprocess.DEVNULL) as run:
        try:
            until(lambda: plan.name in running() and counted(plan.name) > 3)
            result = find(plan.name).tell(StopOrder())
            status = run.wait(60)
        finally:
            run.kill()

    assert result == StopResult(graph=plan.name, pid=run.pid)
    assert status == 0
    assert plan.name not in running()
    edges = json.loads(report.read_text())["edges"]
    assert all(edge["in_flight"] == 0 for edge in edges)


def test_a_second_stop_order_ends_the_run_in_haste(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOSSLESS)
    with Supervisor(plan) as supervisor:
        supervisor.start()
        wait_for(supervisor, lambda: handled(supervisor, "count") > 3)
        for count in (1, 2):
            beside(supervisor, lambda: find(plan.name).tell(StopOrder()))
            assert supervisor.end_requests == count

        assert supervisor.in_haste


def test_a_swap_that_is_under_way_does_not_delay_the_end(tmp_path: Path) -> None:
    results: list[Result] = []
    plan = plan_of(tmp_path, LOSSLESS)

    with Supervisor(plan) as supervisor:
        supervisor.start()
        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        for order in (SwapOrder(node="work", at=10**9), StopOrder()):
            supervisor.control.take(order, results.append)
        assert supervisor.end_requests == 1
        supervisor.finish()

    assert isinstance(results[0], StopResult)
    assert results[1] == Refused(f"{plan.name}: the run ended before that was done")


def test_an_order_that_comes_after_the_end_is_answered_at_once(tmp_path: Path) -> None:
    answers: list[bytes] = []
    plan = plan_of(tmp_path, LOSSLESS)
    with Supervisor(plan) as supervisor:
        supervisor.start()
        supervisor.finish()

    supervisor.control.ask(encode(SwapOrder(node="work")), answers.append)

    assert [decode(RESULT, answer) for answer in answers] == [
        Refused(f"{plan.name}: the run ended before that was done")
    ]


def test_an_order_to_a_graph_that_has_ended_is_refused_in_one_sentence(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOSSLESS)

    with pytest.raises(RunError, match=f"no graph {plan.name} runs"):
        find(plan.name).tell(StopOrder())


def test_a_part_of_a_deployed_graph_is_ended_where_it_was_deployed(tmp_path: Path) -> None:
    text = LOSSLESS.replace("  work:\n", "  work:\n    host: eye\n")
    text = text.replace("  ticker:\n", "  ticker:\n    host: eye\n")
    text = text.replace("  count:\n", "  count:\n    host: eye\n")
    plan = plan_of(tmp_path, f"hosts: [eye]\n{text}")

    with (
        Supervisor(replace(plan, here="eye")) as supervisor,
        pytest.raises(RunError, match=f"was deployed; `fovea stop {plan.name}` ends it"),
    ):
        supervisor.control.take(StopOrder(), lambda _: None)


def test_a_stop_while_nodes_open_closes_what_was_opened_and_exposes_nothing(
    tmp_path: Path,
) -> None:
    plan = plan_of(tmp_path, SLOW_START.replace("FOLDER", str(tmp_path)))
    with Supervisor(plan) as supervisor:
        supervisor.asked_to_end = lambda: int((tmp_path / "eye-opens").exists())
        supervisor.start()
        supervisor.stop()
        report = account_of(supervisor, supervisor.exposed_s)

    opened, closed, exposed = (
        [path.name.partition("-")[0] for path in sorted(tmp_path.glob(f"*-{deed}"))]
        for deed in ("opened", "closes", "exposes")
    )
    assert "eye" in opened
    assert (closed, exposed) == (opened, [])
    assert (report["crashes"], report["duration_s"]) == ({}, 0)
    assert report["verdict"][0]["sentence"] == "no frame was made"


def test_a_graph_that_is_stopped_before_it_ran_names_no_rate(tmp_path: Path) -> None:
    with Supervisor(plan_of(tmp_path, LOSSLESS)) as supervisor:
        supervisor.asked_to_end = lambda: 1
        supervisor.start()
        supervisor.stop()

        assert (supervisor.begun, supervisor.exposed_s) == (False, 0)
