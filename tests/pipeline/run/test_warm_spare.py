"""If no spare process can be started, restarts are slower, but the graph keeps running."""

import os
import signal
import sys
import time
from collections.abc import Collection
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline.module_files import edited_since, module_files
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
    together,
    wait_for,
    wait_for_progress,
)


def test_a_spare_that_cannot_be_started_is_no_error_and_is_not_retried_at_once() -> None:
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
        supervisor.manager.spare.dismiss()
        with monkeypatch.context() as patch:
            patch.setattr("pipeline.run.process_manager.spawn", refuse)
            send_signal(supervisor, "steer", signal.SIGKILL)
            wait_for(supervisor, lambda: len(refusals) > 1)
            wait_for_progress(supervisor, "pair")
        wait_for_progress(supervisor, "steer")
        supervisor.finish()

    report = go(plan_of(tmp_path, together(LOOP, "work", "pair")), 0, kill)

    assert report["failure"] == ""
    assert report["restarts"] == {"steer": 1}
    assert_accounts_add_up(report)


def test_a_module_beside_the_installation_that_is_edited_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "site-packages-of-mine" / "mine.py"
    file.parent.mkdir()
    file.touch()
    monkeypatch.setattr(
        "pipeline.module_files.INSTALLED", (os.path.join(tmp_path, "site-packages", ""),)
    )
    monkeypatch.setitem(sys.modules, "mine", SimpleNamespace(__file__=str(file)))  # type: ignore[arg-type]
    moment_s = time.time() + 60

    assert not edited_since(moment_s, module_files())

    os.utime(file, (moment_s + 60,) * 2)

    assert edited_since(moment_s, module_files())


def test_a_module_of_the_installation_is_not_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "theirs.py"
    file.touch()
    moment_s = time.time() + 60
    os.utime(file, (moment_s + 60,) * 2)
    monkeypatch.setitem(sys.modules, "theirs", SimpleNamespace(__file__=str(file)))  # type: ignore[arg-type]
    monkeypatch.setattr("pipeline.module_files.INSTALLED", (os.path.join(tmp_path, ""),))

    assert not edited_since(moment_s, module_files())
