"""A swap keeps live changes of settings, and changes only what its order sets."""

from pathlib import Path
from typing import Any

import pytest

from pipeline.client.find import find
from pipeline.protocol.orders import Result
from pipeline.run.process_handle import NodeProcess, spawn
from pipeline.run.rundir import base
from pipeline.run.supervisor import Supervisor
from tests.pipeline.run.test_swap import order
from tests.sample_graphs import (
    LOSSLESS,
    account_of,
    beside,
    go,
    handled,
    plan_of,
    reasons,
    wait_for,
    wait_for_progress,
)

GLANCE = """\
  glance:
    operator: tests.samples:Pass
    inputs: {frame: ticker.roi}
"""
Results = list[Result]


@pytest.mark.lengthy
@pytest.mark.parametrize("group", ["", "    group: hand\n"])
def test_a_swap_keeps_live_changes_except_where_its_order_sets_another_value(
    tmp_path: Path, group: str
) -> None:
    text = LOSSLESS.replace("  work:\n", f"  work:\n{group}") + GLANCE + group
    plan = plan_of(tmp_path, text)
    log = base() / plan.name / f"{plan.node('work').process}.log"
    effective = []

    def operate() -> None:
        with log.open("a") as words:
            words.write("said before\n")
        for changes in ({"hold": 1}, {"every": 3}):
            find(plan.name).configure("work", {"every": 2})
            find(plan.name).swap(order("work", changes=changes))
            settings = find(plan.name).configure("work", {}).settings
            effective.append((settings["every"], settings["hold"]))

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        beside(supervisor, operate)
        supervisor.finish()

    go(plan, 0, during)

    assert effective == [(2, 1), (3, 1)]
    assert "said before" in log.read_text()


def test_a_setting_that_changes_while_a_successor_gets_ready_is_not_lost(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOSSLESS, changes=("ticker.rate_hz=4",))
    results: Results = []
    kept: dict[str, Any] = {}

    def tell_meanwhile() -> None:
        find(plan.name).configure("work", {"every": 7})
        find(plan.name).configure("ticker", {"rate_hz": 60})  # now the cut may come

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        late = order("work", at=handled(supervisor, "work") + 300)
        supervisor.control.take(late, results.append)
        wait_for(supervisor, lambda: account_of(supervisor, "work.frame").next_receiver_epoch != 0)
        beside(supervisor, tell_meanwhile)
        wait_for(supervisor, lambda: bool(results))
        settings = beside(supervisor, lambda: find(plan.name).configure("work", {})).settings
        kept.update(settings)
        supervisor.finish()

    go(plan, 0, during)

    assert "its settings were changed meanwhile, try again" in reasons(results)[0]
    assert kept["every"] == 7


def test_a_successor_that_cannot_be_started_leaves_the_old_part_its_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    group = "    group: hand\n"
    plan = plan_of(tmp_path, LOSSLESS.replace("  work:\n", f"  work:\n{group}") + GLANCE + group)
    results: Results = []
    kept: dict[str, Any] = {}

    def during(supervisor: Supervisor) -> None:
        def refuse_while_swapping(*args: Any, **kwargs: Any) -> NodeProcess:
            if supervisor.control.owns(supervisor.processes["hand"]):
                raise BlockingIOError("Resource temporarily unavailable")
            return spawn(*args, **kwargs)

        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        beside(supervisor, lambda: find(plan.name).configure("work", {"every": 2}))
        monkeypatch.setattr("pipeline.run.process_manager.spawn", refuse_while_swapping)
        monkeypatch.setattr(supervisor.manager.spare, "take", lambda: None)
        supervisor.control.take(order("work"), results.append)
        wait_for(supervisor, lambda: bool(results))
        wait_for(supervisor, lambda: supervisor.pid("hand") != 0)
        wait_for_progress(supervisor, "work")
        settings = beside(supervisor, lambda: find(plan.name).configure("work", {})).settings
        kept.update(settings)
        supervisor.finish()

    go(plan, 0, during)

    assert "hand: cannot be started: Resource temporarily unavailable" in reasons(results)[0]
    assert kept["every"] == 2
