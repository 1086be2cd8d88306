"""Frozen, dead-locked, leaking, slow or looping nodes are handled; the others keep running."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from pipeline import RunError
from pipeline.bus.ledger import Ledger
from pipeline.node.health import FROZEN_S
from pipeline.run.rundir import base, memory_of, running
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import (
    CHAIN,
    KILLED,
    LOOP,
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

SICK = """\
nodes:
  ticker:
    operator: tests.samples:Ticker
    group: ends
    settings: {rate_hz: 20, side_px: 60}
  sick:
    operator: tests.faulty_samples:Sick
    inputs: {frame: {from: ticker.context, depth: 30}}
  after:
    operator: tests.samples:Count
    group: ends
    inputs: {frame: sick}
  beside:
    operator: tests.samples:Count
    group: ends
    inputs: {frame: {from: ticker.roi, depth: 60}}
"""


def sick(**more: object) -> str:
    lines = "".join(f"    {key}: {value}\n" for key, value in more.items())
    return SICK.replace("  sick:\n", f"  sick:\n{lines}")


def recovers(supervisor: Supervisor, node: str, last: str) -> None:
    wait_for(supervisor, lambda: supervisor.restarts.get(node) == 1)
    wait_for_progress(supervisor, last)


@pytest.mark.parametrize("victim", [pytest.param("ticker", marks=pytest.mark.slow), "steer"])
def test_a_frozen_process_is_replaced_whatever_it_was_doing(tmp_path: Path, victim: str) -> None:
    plan = plan_of(tmp_path, together(LOOP, "work", "pair"))
    took: list[float] = []

    def freeze(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "steer") > 5)
        began = time.monotonic()
        send_signal(supervisor, victim, signal.SIGSTOP)
        recovers(supervisor, victim, "steer")
        took.append(time.monotonic() - began)
        supervisor.finish()

    report = go(plan, 0, freeze)

    assert_accounts_add_up(report)
    assert report["restarts"] == {victim: 1}
    assert took[0] > FROZEN_S


@pytest.mark.parametrize("kind", [pytest.param("deadlock", marks=pytest.mark.slow), "seize"])
def test_a_locked_operator_is_killed_and_its_stack_is_in_its_log(tmp_path: Path, kind: str) -> None:
    plan = plan_of(tmp_path, sick(stall_s=0.5), changes=(f"sick.kind={kind}",))

    def until_it_works_again(supervisor: Supervisor) -> None:
        recovers(supervisor, "sick", "after")
        supervisor.finish()

    report = go(plan, 0, until_it_works_again)

    log = (base() / plan.name / "sick.log").read_text()
    assert_accounts_add_up(report)
    assert report["restarts"] == {"sick": 1}
    assert 'faulty_samples.py", line' in log
    assert "in on_frame" in log
    assert edge(report, "sick.frame")["lost_in_crash"] >= 1  # the frame that it hung on


@pytest.mark.slow
def test_an_operator_that_exceeds_its_memory_limit_is_restarted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    plan = plan_of(tmp_path, sick(memory_mb=250), changes=("sick.kind=leak",))

    def until_it_works_again(supervisor: Supervisor) -> None:
        recovers(supervisor, "sick", "after")
        supervisor.finish()

    report = go(plan, 0, until_it_works_again)

    assert_accounts_add_up(report)
    assert report["restarts"]["sick"] >= 1
    assert report["failure"] == ""
    assert " MB of its own, 250 allowed; killed" in caplog.text


def test_a_node_that_never_gets_ready_is_named_after_its_timeout(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, sick(start_s=3), changes=("sick.open_s=1000",))

    said = rf"sick: not ready after 3.*, see `fovea logs {plan.name} sick`$"
    with Supervisor(plan) as supervisor, pytest.raises(RunError, match=said):
        supervisor.start()


@pytest.mark.slow
def test_a_node_that_hangs_when_it_restarts_is_killed_and_a_slow_one_is_not(
    tmp_path: Path,
) -> None:
    changes = (f"sick.again={tmp_path / 'seen'}", "sick.open_s=60")
    plan = plan_of(tmp_path, sick(start_s=6), changes=changes)

    def kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "after") > 5)
        send_signal(supervisor, "sick", signal.SIGKILL)
        wait_for(supervisor, lambda: supervisor.restarts.get("sick") == 1)
        (tmp_path / "seen").write_text("once")
        wait_for(supervisor, lambda: supervisor.restarts.get("sick") == 2)
        (tmp_path / "seen").write_text("twice")
        wait_for_progress(supervisor, "after")
        supervisor.finish()

    report = go(plan, 0, kill)

    assert report["restarts"] == {"sick": 2}
    beside = edge(report, "beside.frame")
    exposed = report["frames"]["exposed"]
    assert beside["delivered"] + beside["dropped"].get("overrun", 0) == exposed


@pytest.mark.slow
def test_a_crash_loop_does_not_affect_the_others_and_ends_with_its_reason(tmp_path: Path) -> None:
    text = CHAIN.replace("  glance:\n", "  glance:\n    restart: {most: 3, backoff_s: 0.2}\n")
    plan = plan_of(tmp_path, text, changes=("glance.crash_after=1",))

    report = go(plan, 0)

    assert report["failure"].startswith("glance died 4 times within 60 s: ")
    assert report["failure"].endswith(": ValueError: told not to live for long")
    assert edge(report, "count.frame")["dropped"] == {}
    assert edge(report, "count.frame")["delivered"] > 20


@pytest.mark.slow
def test_a_graph_frozen_as_a_whole_goes_on_without_a_restart(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP)
    command = [sys.executable, "-c", KILLED, str(tmp_path / "graph.yaml")]
    supervisor = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert supervisor.stdout is not None
    supervisor.stdout.readline()
    before = running()[plan.name]["pids"]
    ledger = Ledger.open(memory_of(running()[plan.name]))
    everybody = [supervisor.pid, *before.values()]

    for pid in everybody:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(FROZEN_S + 1)  # longer than a process may be silent
    for pid in everybody:
        os.kill(pid, signal.SIGCONT)
    accounts = [ledger.nodes[node.index] for node in plan.nodes]
    seen = [account.handled for account in accounts]
    until(lambda: all(a.handled > s + 60 for a, s in zip(accounts, seen, strict=True)))

    assert running()[plan.name]["pids"] == before
    assert all(psutil.Process(pid).is_running() for pid in everybody)
    supervisor.kill()
    supervisor.wait()
    supervisor.stdout.close()


def test_of_two_supervisors_that_start_at_once_one_is_refused(tmp_path: Path) -> None:
    path = plan_of(tmp_path, together(LOOP, "work", "pair", "steer")) and tmp_path / "graph.yaml"
    command = [sys.executable, "-m", "pipeline.cli", "run", str(path)]
    both = [
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]

    until(lambda: any(process.poll() is not None for process in both))
    both.sort(key=lambda process: process.poll() is None)
    _, refused = both[0].communicate(timeout=60)
    both[1].send_signal(signal.SIGTERM)  # it would run for ever
    both[1].communicate(timeout=60)

    assert [process.returncode for process in both] == [1, 128 + signal.SIGTERM]
    assert refused.strip().endswith("already running, see `fovea ps`")
