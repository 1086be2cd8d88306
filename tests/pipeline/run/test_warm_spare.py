"""A machine that gives no process costs the head start, or a moment, never the graph."""

import signal
from collections.abc import Collection
from pathlib import Path

import pytest

from pipeline.run.process_handle import NodeProcess
from pipeline.run.supervisor import Supervisor
from pipeline.run.warm_spare import WarmSpare
from tests.sample_graphs import (
    LOOP,
    assert_accounts_add_up,
    go,
    handled,
    plan_of,
    send_signal,
    wait_for,
    wait_for_progress,
)


def test_no_process_to_stand_by_is_no_error_and_not_asked_for_again_at_once() -> None:
    asked: list[Collection[str]] = []

    def refuse(modules: Collection[str]) -> NodeProcess:
        asked.append(modules)
        raise BlockingIOError("Resource temporarily unavailable")

    spare = WarmSpare(refuse)
    for _ in range(3):
        spare.keep(["tests.samples"])

    assert spare.take() is None
    assert len(asked) == 1


def test_a_node_that_cannot_be_started_is_tried_again_and_the_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refusals = []

    def refuse(*_: object, **__: object) -> NodeProcess:
        refusals.append(1)
        raise BlockingIOError("Resource temporarily unavailable")

    def kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "steer") > 5)
        supervisor.spare.dismiss()
        with monkeypatch.context() as patch:
            patch.setattr("pipeline.run.process_manager.spawn", refuse)
            send_signal(supervisor, "steer", signal.SIGKILL)
            wait_for(supervisor, lambda: len(refusals) > 1)
            wait_for_progress(supervisor, "pair")
        wait_for_progress(supervisor, "steer")
        supervisor.finish()

    report = go(plan_of(tmp_path, LOOP), 0, kill)

    assert report["failure"] == ""
    assert report["restarts"] == {"steer": 1}
    assert_accounts_add_up(report)
