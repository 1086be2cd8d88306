"""Graphs run as real processes on the real bus and lose nothing on lossless edges."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from pipeline import RunError
from pipeline.client.find import find
from pipeline.run.inline import InlineRunner
from pipeline.run.memory_folder import path_of
from pipeline.run.rundir import running
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import (
    CHAIN,
    KILLED,
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


def until_steered(supervisor: Supervisor) -> None:
    """Let the loop run until the source has had more than twenty commands."""
    wait_for(supervisor, lambda: account_of(supervisor, "ticker.schedule").delivered > 20)
    supervisor.finish()


def test_the_loop_closes_every_account_adds_up_and_nothing_is_left_behind(tmp_path: Path) -> None:
    plan, seen = plan_of(tmp_path, LOOP), set()

    def during(supervisor: Supervisor) -> None:
        seen.add(running()[plan.name]["run"])
        until_steered(supervisor)

    began_s = time.monotonic()
    report = go(plan, 0, during)
    took_ms = 1000 * (time.monotonic() - began_s)

    assert_accounts_add_up(report)
    assert report["loop"]["commands"] > 20
    assert 0 < report["loop"]["latency_ms"]["p50"] < took_ms
    assert edge(report, "steer.percept")["dropped"] == {}
    (run_id,) = seen
    assert not path_of(run_id).exists()
    assert not [p for p in psutil.Process().children() if "pipeline.node.process" in p.cmdline()]


def test_a_run_of_so_many_frames_exposes_them_and_in_lockstep_answers_each(tmp_path: Path) -> None:
    text = together(LOOP, "work", "pair", "steer")
    realtime = go(plan_of(tmp_path, text), 30)
    lockstep = go(plan_of(tmp_path, text, clock="lockstep"), 30)

    for report in (realtime, lockstep):
        assert report["frames"] == {"exposed": 30, "skipped": 0}
        assert_accounts_add_up(report)
    assert lockstep["loop"]["commands"] == 30


def test_lockstep_gives_the_same_commands_in_line_and_as_processes(tmp_path: Path) -> None:
    plan, grouped = (
        plan_of(tmp_path, text, clock="lockstep", changes=("work.every=3",))
        for text in (LOOP, together(LOOP, "work", "pair", "steer"))
    )

    hashes = {go(one, 40)["schedule_sha256"] for one in (plan, grouped)}
    for _ in range(2):
        with InlineRunner(plan) as runner:
            assert list(runner.run(40)) == list(range(40))
            hashes.add(runner.report()["schedule_sha256"])

    assert len(hashes) == 1


def test_a_reader_that_stands_still_on_a_lossless_edge_loses_nothing(tmp_path: Path) -> None:
    frames = 60  # a camera does not wait: the edge holds all frames, however slow the machine
    text = together(CHAIN, "ticker", "glance")
    plan = plan_of(tmp_path, text, changes=("ticker.rate_hz=1",))

    def freeze(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "count") > 0)
        pid = send_signal(supervisor, "count", signal.SIGSTOP)
        find(plan.name).configure("ticker", {"rate_hz": 200})
        until(
            lambda: account_of(supervisor, "count.frame").sent == frames
        )  # no process is replaced
        os.kill(pid, signal.SIGCONT)

    report = go(plan, frames, freeze)

    assert_accounts_add_up(report)
    assert edge(report, "count.frame")["delivered"] == frames
    assert edge(report, "count.frame")["dropped"] == {}
    assert report["summaries"]["count"] == {"seen": list(range(frames)), "torn": 0}


def test_a_writer_waits_for_a_stopped_lossless_reader(tmp_path: Path) -> None:
    text = CHAIN + "  relay:\n    operator: tests.samples:PassEvery\n"
    text += "    inputs: {frame: {from: ticker.context, depth: 60}}\n"
    text += (
        "  last:\n    operator: tests.samples:Count\n    inputs: {frame: {from: relay, depth: 2}}\n"
    )

    def freeze(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "last") > 5)
        pid = send_signal(supervisor, "last", signal.SIGSTOP)
        relay = supervisor.ledger.nodes[supervisor.plan.node("relay").index]
        until(lambda: relay.condition == "credit")
        os.kill(pid, signal.SIGCONT)
        wait_for(supervisor, lambda: relay.condition != "credit")
        supervisor.finish()

    report = go(plan_of(tmp_path, text), 0, freeze)

    assert_accounts_add_up(report)
    seen = list(range(report["frames"]["exposed"]))
    assert report["summaries"]["last"] == {"seen": seen, "torn": 0}, report["edges"]


def test_a_source_that_cannot_wait_counts_an_overrun_on_every_edge(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, CHAIN, changes=("count.sleep_s=0.03", "ticker.rate_hz=120"))

    def until_overrun(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: account_of(supervisor, "count.frame").overrun > 10)
        supervisor.finish()

    report = go(plan, 0, until_overrun)

    assert_accounts_add_up(report)
    overruns = [edge(report, end)["dropped"]["overrun"] for end in ("count.frame", "glance.frame")]
    assert overruns[0] == overruns[1] > 10
    exposed = report["frames"]["exposed"]
    assert edge(report, "count.frame")["delivered"] == exposed - overruns[0]


def test_a_slow_reader_of_the_latest_never_slows_a_lossless_one(tmp_path: Path) -> None:
    def until_superseded(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: account_of(supervisor, "glance.frame").superseded > 20)
        supervisor.finish()

    plan = plan_of(tmp_path, CHAIN, changes=("glance.sleep_s=0.2",))
    report = go(plan, 0, until_superseded)

    assert_accounts_add_up(report)
    assert edge(report, "count.frame")["delivered"] == report["frames"]["exposed"]
    assert edge(report, "glance.frame")["dropped"]["superseded"] > 20


def test_a_join_of_two_lossless_paths_does_not_wait_for_a_frame_lost_on_one(
    tmp_path: Path,
) -> None:
    text = (
        CHAIN.partition("  count:")[0]
        + """\
  work:
    operator: tests.samples:PassEvery
    inputs: {frame: {from: ticker.context, depth: 4}}
  relay:
    operator: tests.samples:PassEvery
    inputs: {frame: {from: work, depth: 4}}
  pair:
    operator: tests.samples:PairEvery
    inputs: {left: {from: relay, depth: 4}, right: {from: ticker.roi, depth: 4}}
"""
    )
    plan = plan_of(tmp_path, text)

    def freeze_and_kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "pair") > 5)
        pid = send_signal(supervisor, "work", signal.SIGSTOP)
        account = account_of(supervisor, "work.frame")
        until(lambda: account.in_flight > 2)  # frames pile up before it
        os.kill(pid, signal.SIGKILL)
        wait_for(supervisor, lambda: bool(supervisor.restarts))
        wait_for_progress(supervisor, "pair", 10)
        supervisor.finish()

    report = go(plan, 0, freeze_and_kill)

    assert edge(report, "work.frame")["lost_in_crash"] > 0
    assert edge(report, "pair.right")["dropped"]["unmatched"] > 0
    assert_accounts_add_up(report)


def test_a_graph_runs_once_at_a_time(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP)

    with Supervisor(plan) as supervisor:
        supervisor.manager.note()
        with pytest.raises(RunError, match="already running"):
            Supervisor(plan)


def test_a_reader_without_shared_memory_gets_the_bytes(tmp_path: Path) -> None:
    text = CHAIN.replace("depth: 60", "depth: 60, transport: bytes")

    report = go(plan_of(tmp_path, text), 60)

    assert report["summaries"]["count"] == {"seen": list(range(60)), "torn": 0}
    assert_accounts_add_up(report)


def test_operators_of_a_group_share_a_process(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, together(LOOP, "work", "pair"))
    assert set(plan.processes()) == {"ticker", "hand", "steer"}

    report = go(plan, 0, until_steered)

    assert report["loop"]["commands"] > 20
    assert_accounts_add_up(report)


def test_no_process_of_a_graph_opens_a_socket_of_a_network(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, together(LOOP, "work", "pair"))
    own = psutil.Process()
    before, opened = set(own.net_connections("inet")), set()

    def during(supervisor: Supervisor) -> None:
        wait_for_progress(supervisor, "steer")
        nodes = [psutil.Process(supervisor.pid(name)) for name in plan.processes()]
        opened.update(link for each in (own, *nodes) for link in each.net_connections("inet"))
        supervisor.finish()

    go(plan, 0, during)

    assert opened <= before


def test_the_nodes_of_a_killed_supervisor_end_and_the_next_start_cleans_up(
    tmp_path: Path,
) -> None:
    plan = plan_of(tmp_path, LOOP)
    command = [sys.executable, "-c", KILLED, str(tmp_path / "graph.yaml")]
    supervisor = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert supervisor.stdout is not None
    assert supervisor.stdout.readline() == b"running\n"
    facts = running()[plan.name]
    children = [psutil.Process(pid) for pid in facts["pids"].values()]

    supervisor.kill()
    supervisor.wait()
    supervisor.stdout.close()

    gone, alive = psutil.wait_procs(children, timeout=60)
    assert (len(gone), alive) == (4, [])
    assert plan.name not in running()
    go(replace(plan, nodes=tuple(replace(node, group="all") for node in plan.nodes)), 5)
    assert not path_of(facts["run"]).exists()
