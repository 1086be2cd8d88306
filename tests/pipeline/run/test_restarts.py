"""A node that dies or hangs is started again, and no message is lost without being counted."""

import os
import re
import signal
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pipeline.graph.plan import Node, Restart
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.restarts import Restarts
from pipeline.run.rundir import base
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import (
    CHAIN,
    LOOP,
    account_of,
    assert_accounts_add_up,
    edge,
    go,
    handled,
    plan_of,
    send_signal,
    together,
    until,
    wait_for,
    wait_for_progress,
)


class Lingering:
    """A deaf process that, as one with gigabytes to free, has not ended when it was killed."""

    deaf = True

    def __init__(self, handle: ProcessHandle | None) -> None:
        self._handle = handle

    def __getattr__(self, name: str) -> Any:
        return getattr(self._handle, name)

    def ended(self) -> None:
        """Say that it lives."""


@pytest.mark.lengthy
def test_killed_operators_come_back_and_the_accounts_still_add_up(tmp_path: Path) -> None:
    victims = ("ticker", "work", "pair", "steer")

    def kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "steer") > 10)
        for victim in victims:
            send_signal(supervisor, victim, signal.SIGKILL)
            wait_for(supervisor, partial(supervisor.restarts.get, victim))
            account = supervisor.ledger.nodes[supervisor.plan.node(victim).index]
            wait_for(
                supervisor,
                lambda account=account: account.condition in ("waiting", "busy"),  # type: ignore[misc]
            )
            wait_for_progress(supervisor, "steer")
        supervisor.finish()

    report = go(plan_of(tmp_path, LOOP), 0, kill)

    assert_accounts_add_up(report)
    assert report["restarts"] == dict.fromkeys(victims, 1)
    assert report["failure"] == ""


def test_a_process_that_takes_long_to_end_is_killed_and_named_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with Supervisor(plan_of(tmp_path, together(CHAIN, "ticker", "glance"))) as supervisor:
        supervisor.start()
        managed = supervisor.processes["count"]
        handle, managed.handle = managed.handle, cast("ProcessHandle", Lingering(managed.handle))
        for _ in range(5):
            supervisor.tick()
        managed.handle = handle

    said = [message for message in caplog.messages if message.endswith("; killed")]
    assert said == ["count: does not read what it is told; killed"]


def test_a_run_ends_while_its_source_is_away(tmp_path: Path) -> None:
    def kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "steer") > 5)
        send_signal(supervisor, "ticker", signal.SIGKILL)
        supervisor.finish()
        assert supervisor.finished
        assert supervisor.pid("ticker") == 0

    report = go(plan_of(tmp_path, together(LOOP, "work", "pair", "steer")), 0, kill)

    assert (report["failure"], report["restarts"].get("ticker", 1)) == ("", 1)


def test_what_was_under_way_to_a_node_that_does_not_come_back_is_lost_in_a_crash(
    tmp_path: Path,
) -> None:
    text = together(CHAIN, "ticker", "glance")
    text = text.replace("  count:\n", "  count:\n    restart: never\n")

    def kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "count") > 5)
        pid = send_signal(supervisor, "count", signal.SIGSTOP)
        account = account_of(supervisor, "count.frame")
        until(lambda: account.in_flight > 2)
        os.kill(pid, signal.SIGKILL)
        wait_for(supervisor, lambda: supervisor.pid("count") == 0)
        supervisor.finish()

    report = go(plan_of(tmp_path, text), 0, kill)

    assert edge(report, "count.frame")["lost_in_crash"] > 2
    assert_accounts_add_up(report)


def test_a_node_that_shall_never_restart_stays_away_and_the_graph_goes_on(tmp_path: Path) -> None:
    text = together(CHAIN, "ticker", "glance")
    text = text.replace("  count:\n", "  count:\n    restart: never\n")

    def kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "count") > 5)
        send_signal(supervisor, "count", signal.SIGKILL)
        wait_for(supervisor, lambda: supervisor.pid("count") == 0)
        wait_for_progress(supervisor, "glance", 20)
        supervisor.finish()

    report = go(plan_of(tmp_path, text), 0, kill)

    assert report["restarts"] == {}
    assert edge(report, "glance.frame")["offered"] == report["frames"]["exposed"]
    assert "overrun" not in edge(report, "glance.frame")["dropped"]


@pytest.mark.lengthy
def test_a_node_that_dies_too_often_ends_the_run(tmp_path: Path) -> None:
    text = together(LOOP, "pair", "steer")
    text = text.replace("  work:\n", "  work:\n    restart: {most: 2, backoff_s: 0.01}\n")
    plan = plan_of(tmp_path, text, changes=("work.every=1", "work.crash_after=3"))

    report = go(plan, 0)

    assert "work died 3 times" in report["failure"]


def test_an_exception_is_in_the_log_and_the_graph_goes_on(tmp_path: Path) -> None:
    text = together(LOOP, "pair", "steer")
    text = text.replace("frame: ticker.context", "frame: {from: ticker.context, keep: every}")
    plan = plan_of(tmp_path, text, changes=("work.crash_at=20",))

    def until_it_is_back(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: supervisor.restarts.get("work") == 1)
        wait_for_progress(supervisor, "work")
        supervisor.finish()

    report = go(plan, 0, until_it_is_back)

    log = (base() / plan.name / "work.log").read_text()
    assert "ValueError: told to crash" in log
    assert "Traceback" in log
    assert report["restarts"] == {"work": 1}
    assert_accounts_add_up(report)


def test_in_lockstep_a_crash_ends_the_run_with_an_error(tmp_path: Path) -> None:
    text = together(LOOP, "pair", "steer")
    report = go(plan_of(tmp_path, text, clock="lockstep", changes=("work.crash_at=5",)), 50)

    said = report["failure"]
    assert said.startswith("work ended by exit status 1: a lockstep run cannot go on: ")
    assert re.search(r"tests/samples\.py:[0-9]+: ValueError: told to crash$", said)


@pytest.mark.parametrize("clock", ["realtime", "lockstep"])
@pytest.mark.parametrize(
    ("change", "said"),
    [("ticker.fail_at=9", "picture 9: torn"), ("ticker.jam_at=9", "a command: jammed")],
)
def test_a_source_that_breaks_ends_the_run_with_its_sentence(
    tmp_path: Path, clock: str, change: str, said: str
) -> None:
    text = together(LOOP, "work", "pair", "steer")
    report = go(plan_of(tmp_path, text, clock=clock, changes=(change,)), 0)

    assert report["failure"] == said
    assert report["frames"]["exposed"] >= 9


def test_only_the_root_of_a_stall_is_killed(tmp_path: Path) -> None:
    text = LOOP.replace(
        "    operator: tests.samples:Pair\n", "    operator: tests.samples:PairEvery\n"
    )
    text = text.replace("    inputs: {frame: ticker.context}\n",
                        "    inputs: {frame: {from: ticker.context, keep: every}}\n"
                        "    stall_s: 0.5\n")  # fmt: skip
    plan = plan_of(tmp_path, text, changes=("work.hang_at=20",))

    def until_killed(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: bool(supervisor.restarts))
        wait_for_progress(supervisor, "pair")
        supervisor.finish()

    report = go(plan, 0, until_killed)

    assert report["restarts"] == {"work": 1}
    assert (
        "time.sleep" in (base() / plan.name / "work.log").read_text()
        or "samples.py" in (base() / plan.name / "work.log").read_text()
    )


def manager_of(clock: str = "realtime") -> Any:
    """Return what restarts ask of a manager."""
    return SimpleNamespace(
        plan=SimpleNamespace(clock=clock), restarts={}, crashes={}, failure="",
        run_folder=SimpleNamespace(to_read=lambda _: "`its log`"), is_unborn=lambda _: False,
        vacate=lambda _: None, note=lambda: None, sources_wait=False, finished=False,
        finished_sources=frozenset(), ending=False,
    )  # fmt: skip


def eye(**rule: Any) -> ManagedProcess:
    """Return a process of one node with a restart policy."""
    node = Node(index=0, name="eye", operator="m:Eye", settings={}, restart=Restart(**rule))
    return ManagedProcess("eye", (node,))


def test_the_end_of_a_process_is_told_with_when_it_starts_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    restarts, managed = Restarts(manager_of()), eye(most=2, backoff_s=0.1)

    for now_s in (1000.0, 1001.0, 1002.0):
        restarts.on_end(managed, 1, now_s)
        managed.next_start_s = 0.0
    Restarts(manager_of()).on_end(eye(policy="never"), 1, 1000.0)

    begin = "eye ended by exit status 1, see `its log`"
    assert caplog.messages == [
        f"{begin}; starts again in 0.2 s (1 of 2 times in 60 s)",
        f"{begin}; starts again in 0.4 s (2 of 2 times in 60 s)",
        begin,
        begin,
    ]


@pytest.mark.parametrize("most", [0, 63, 64, 200])
def test_a_limit_of_restarts_is_reached_however_high_it_is(most: int) -> None:
    managed, manager = eye(most=most, window_s=1000.0, backoff_s=0.001), manager_of()
    restarts = Restarts(manager)

    for death in range(most + 1):
        assert manager.failure == ""
        restarts.on_end(managed, 1, 1000 + death / 10)

    assert manager.failure == f"eye died {most + 1} times within 1000 s"
