"""Orders for swaps over the bus: refused or answered, whatever happens to the run."""

import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from pipeline import GraphError, RunError
from pipeline.cli.results import swap_lines
from pipeline.client.find import find
from pipeline.protocol.orders import SwapOrder
from pipeline.run.rundir import base
from pipeline.run.supervisor import Supervisor
from pipeline.run.swap_target import laid
from tests.pipeline.run.test_swap import Results, order
from tests.sample_graphs import (
    KILLED,
    LOSSLESS,
    beside,
    go,
    handled,
    plan_of,
    reasons,
    until,
    wait_for,
)


@pytest.mark.parametrize(
    ("changes", "after"),
    [
        ({"options.seed": 8}, {"options": {"scene": "soccer", "seed": 8}, "rate": 2}),
        ({"options": {"seed": 8}}, {"options": {"seed": 8}, "rate": 2}),
        ({"options.sun.low": True, "rate": 3},
         {"options": {"scene": "soccer", "sun": {"low": True}}, "rate": 3}),
        ({"more.of": 1}, {"options": {"scene": "soccer"}, "rate": 2, "more": {"of": 1}}),
        ({"rate.of": 1}, {"options": {"scene": "soccer"}, "rate": 2, "rate.of": 1}),
        ({"options.scene.of": 1},
         {"options": {"scene": "soccer"}, "rate": 2, "options.scene.of": 1}),
    ],
)  # fmt: skip
def test_names_with_dots_change_a_part_of_a_setting_and_leave_the_rest(
    changes: dict[str, object], after: dict[str, object]
) -> None:
    settings = {"options": {"scene": "soccer"}, "rate": 2}

    assert laid(settings, changes) == after

    assert settings == {"options": {"scene": "soccer"}, "rate": 2}


def test_a_part_of_a_setting_that_is_empty_is_its_first_one() -> None:
    assert laid({"options": None}, {"options.seed": 8}) == {"options": {"seed": 8}}


def test_an_order_comes_over_the_bus_and_noise_is_refused(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOSSLESS)
    told: list[str] = []

    def operate() -> None:
        told.extend(swap_lines(find(plan.name).swap(order("work"))))
        for wrong in (SwapOrder(node="wrk"), "noise"):
            with pytest.raises(GraphError) as refusal:
                find(plan.name).tell(wrong)  # type: ignore[arg-type]
            told.append(str(refusal.value))

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        beside(supervisor, operate)
        supervisor.finish()

    go(plan, 0, during)

    assert re.match(r"work: swapped after frame \d+, paused for \d+\.\d ms", told[0])
    assert told[-2].endswith("no node wrk, did you mean 'work'?")
    assert told[-1].startswith("not an order")


def test_an_order_to_a_supervisor_that_is_killed_is_not_waited_for(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOSSLESS)
    command = [sys.executable, "-c", KILLED, str(tmp_path / "graph.yaml")]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE) as supervisor,
        ThreadPoolExecutor(1) as pool,
    ):
        assert supervisor.stdout is not None
        try:
            supervisor.stdout.readline()
            asked = pool.submit(find(plan.name).swap, SwapOrder(node="work", at=10**9))
            until(lambda: asked.done() or any((base() / plan.name).glob("work.2.recv")))
        finally:
            supervisor.kill()  # else leaving the context would wait for it for ever
        with pytest.raises(RunError, match="ended before that was done"):
            asked.result(60)


def test_an_order_that_the_end_of_the_run_overtakes_is_answered(tmp_path: Path) -> None:
    results: Results = []

    with Supervisor(plan_of(tmp_path, LOSSLESS)) as supervisor:
        supervisor.start()
        supervisor.control.take(SwapOrder(node="work"), results.append)
        supervisor.tick()

    assert "the run ended before that was done" in reasons(results)[0]
