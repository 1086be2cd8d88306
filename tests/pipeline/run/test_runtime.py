"""Graphs as real processes on the real bus: they lose nothing they promised to keep."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from pipeline import RunError
from pipeline.run.inline import InlineRunner
from pipeline.run.memory_folder import path_of
from pipeline.run.rundir import base, running
from pipeline.run.supervisor import Supervisor
from tests.toy_graphs import (
    CHAIN,
    KILLED,
    LOOP,
    assert_accounts_add_up,
    edge,
    go,
    handled,
    plan_of,
    wait_for,
)


def test_the_loop_closes_and_every_account_adds_up(tmp_path: Path) -> None:
    report = go(plan_of(tmp_path, LOOP), 60)

    assert_accounts_add_up(report)
    assert report["frames"] == {"exposed": 60, "skipped": 0}
    assert report["loop"]["commands"] > 20  # of 60; a busy machine leaves some out
    assert report["loop"]["latency_ms"]["p50"] < 100
    assert edge(report, "steer.percept")["dropped"] == {}


def test_nothing_is_left_behind(tmp_path: Path) -> None:
    plan, seen = plan_of(tmp_path, LOOP), set()

    def during(_: Supervisor) -> None:
        seen.add(running()[plan.name]["run"])

    go(plan, 10, during)

    (run_id,) = seen
    assert not path_of(run_id).exists()
    assert not [p for p in psutil.Process().children() if "pipeline.node.process" in p.cmdline()]


def test_lockstep_gives_the_same_commands_in_line_and_as_processes(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP, clock="lockstep", changes=("work.every=3",))

    hashes = {go(plan, 40)["schedule_sha256"] for _ in range(2)}
    for _ in range(2):
        with InlineRunner(plan) as runner:
            assert list(runner.run(40)) == list(range(40))
            hashes.add(runner.report()["schedule_sha256"])

    assert len(hashes) == 1


def test_a_reader_stopped_for_a_second_on_a_lossless_edge_loses_nothing(tmp_path: Path) -> None:
    def freeze(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "count") > 5)
        os.kill(supervisor.pid("count"), signal.SIGSTOP)
        end = time.monotonic() + 0.6
        wait_for(supervisor, lambda: time.monotonic() > end)
        os.kill(supervisor.pid("count"), signal.SIGCONT)

    frames = 60  # a camera does not wait: the edge holds all, however long the machine sleeps
    report = go(plan_of(tmp_path, CHAIN), frames, freeze)

    assert_accounts_add_up(report)
    assert edge(report, "count.frame")["delivered"] == frames
    assert edge(report, "count.frame")["dropped"] == {}
    assert report["summaries"]["count"] == {"seen": list(range(frames)), "torn": 0}


def test_a_writer_waits_for_a_stopped_lossless_reader(tmp_path: Path) -> None:
    text = CHAIN + "  relay:\n    operator: tests.toys:PassEvery\n"
    text += "    inputs: {frame: {from: ticker.context, depth: 60}}\n"
    text += (
        "  last:\n    operator: tests.toys:Count\n    inputs: {frame: {from: relay, depth: 2}}\n"
    )

    def freeze(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "last") > 5)
        os.kill(supervisor.pid("last"), signal.SIGSTOP)
        relay = supervisor.ledger.nodes[supervisor.plan.node("relay").index]
        wait_for(supervisor, lambda: relay.condition == "credit")
        os.kill(supervisor.pid("last"), signal.SIGCONT)
        wait_for(supervisor, lambda: relay.condition != "credit")
        supervisor.finish()

    report = go(plan_of(tmp_path, text), 0, freeze)

    assert_accounts_add_up(report)
    seen = list(range(report["frames"]["exposed"]))
    assert report["summaries"]["last"] == {"seen": seen, "torn": 0}, report["edges"]


def test_a_source_that_cannot_wait_counts_an_overrun_on_every_edge(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, CHAIN, changes=("count.sleep_s=0.03",))

    report = go(plan, 180)

    assert_accounts_add_up(report)
    overruns = [edge(report, end)["dropped"]["overrun"] for end in ("count.frame", "glance.frame")]
    assert overruns[0] == overruns[1] > 10
    assert edge(report, "count.frame")["delivered"] == 180 - overruns[0]


def test_a_slow_reader_of_the_latest_never_slows_a_lossless_one(tmp_path: Path) -> None:
    report = go(plan_of(tmp_path, CHAIN, changes=("glance.sleep_s=0.1",)), 100)

    assert_accounts_add_up(report)
    assert edge(report, "count.frame")["delivered"] == 100
    assert edge(report, "glance.frame")["dropped"]["superseded"] > 50


@pytest.mark.parametrize("victim", ["ticker", "work", "pair", "steer"])
def test_a_killed_operator_comes_back_and_the_accounts_still_add_up(
    tmp_path: Path, victim: str
) -> None:
    def kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "steer") > 10)
        os.kill(supervisor.pid(victim), signal.SIGKILL)
        wait_for(supervisor, lambda: supervisor.restarts.get(victim) == 1)
        index = supervisor.plan.node(victim).index
        wait_for(
            supervisor, lambda: supervisor.ledger.nodes[index].condition in ("waiting", "busy")
        )
        after = handled(supervisor, "steer")
        wait_for(supervisor, lambda: handled(supervisor, "steer") > after + 5)
        supervisor.finish()

    report = go(plan_of(tmp_path, LOOP), 0, kill)

    assert_accounts_add_up(report)
    assert report["restarts"] == {victim: 1}
    assert report["failure"] == ""


def test_a_run_ends_at_once_while_its_source_is_away(tmp_path: Path) -> None:
    took: list[float] = []

    def kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "steer") > 5)
        os.kill(supervisor.pid("ticker"), signal.SIGKILL)
        began = time.monotonic()
        supervisor.finish()
        took.append(time.monotonic() - began)
        assert supervisor.finished

    report = go(plan_of(tmp_path, LOOP), 0, kill)

    assert took[0] < 4
    assert_accounts_add_up(report)


def test_a_node_that_shall_never_restart_stays_away_and_the_graph_goes_on(tmp_path: Path) -> None:
    text = CHAIN.replace("  count:\n", "  count:\n    restart: never\n")

    def kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "count") > 5)
        os.kill(supervisor.pid("count"), signal.SIGKILL)
        wait_for(supervisor, lambda: supervisor.pid("count") == 0)
        after = handled(supervisor, "glance")
        wait_for(supervisor, lambda: handled(supervisor, "glance") > after + 20)
        supervisor.finish()

    report = go(plan_of(tmp_path, text), 0, kill)

    assert report["restarts"] == {}
    assert edge(report, "glance.frame")["offered"] == report["frames"]["exposed"]
    assert "overrun" not in edge(report, "glance.frame")["dropped"]


def test_a_node_that_dies_too_often_ends_the_run(tmp_path: Path) -> None:
    text = LOOP.replace("  work:\n", "  work:\n    restart: {most: 2, backoff_s: 0.01}\n")
    plan = plan_of(tmp_path, text, changes=("work.every=1", "work.crash_after=3"))

    report = go(plan, 1000)

    assert "work died 3 times" in report["failure"]


def test_an_exception_is_in_the_log_and_the_graph_goes_on(tmp_path: Path) -> None:
    text = LOOP.replace("frame: ticker.context", "frame: {from: ticker.context, keep: every}")
    plan = plan_of(tmp_path, text, changes=("work.crash_at=20",))

    report = go(plan, 120)

    log = (base() / plan.name / "work.log").read_text()
    assert "ValueError: told to crash" in log
    assert "Traceback" in log
    assert report["restarts"] == {"work": 1}
    assert_accounts_add_up(report)


def test_in_lockstep_a_crash_ends_the_run_with_an_error(tmp_path: Path) -> None:
    report = go(plan_of(tmp_path, LOOP, clock="lockstep", changes=("work.crash_at=5",)), 50)

    assert report["failure"] == (
        "work ended by exit status 1: a lockstep run cannot go on: ValueError: told to crash"
    )


@pytest.mark.parametrize("clock", ["realtime", "lockstep"])
@pytest.mark.parametrize(
    ("change", "said"),
    [("ticker.fail_at=9", "picture 9: torn"), ("ticker.jam_at=9", "a command: jammed")],
)
def test_a_source_that_breaks_ends_the_run_with_its_sentence(
    tmp_path: Path, clock: str, change: str, said: str
) -> None:
    report = go(plan_of(tmp_path, LOOP, clock=clock, changes=(change,)), 0)

    assert report["failure"] == said
    assert report["frames"]["exposed"] < 100


def test_only_the_root_of_a_stall_is_killed(tmp_path: Path) -> None:
    text = LOOP.replace("    operator: tests.toys:Pair\n", "    operator: tests.toys:PairEvery\n")
    text = text.replace("    inputs: {frame: ticker.context}\n",
                        "    inputs: {frame: {from: ticker.context, keep: every}}\n"
                        "    stall_s: 0.5\n")  # fmt: skip
    plan = plan_of(tmp_path, text, changes=("work.hang_at=20",))

    def until_killed(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: bool(supervisor.restarts), 30)
        again = handled(supervisor, "pair")
        wait_for(supervisor, lambda: handled(supervisor, "pair") > again + 5)
        supervisor.finish()

    report = go(plan, 0, until_killed)

    assert report["restarts"] == {"work": 1}
    assert (
        "time.sleep" in (base() / plan.name / "work.log").read_text()
        or "toys.py" in (base() / plan.name / "work.log").read_text()
    )


def test_what_two_lossless_ways_lost_on_one_of_them_is_not_waited_for_on_the_other(
    tmp_path: Path,
) -> None:
    text = (
        CHAIN.partition("  count:")[0]
        + """\
  work:
    operator: tests.toys:PassEvery
    inputs: {frame: {from: ticker.context, depth: 4}}
  relay:
    operator: tests.toys:PassEvery
    inputs: {frame: {from: work, depth: 4}}
  pair:
    operator: tests.toys:PairEvery
    inputs: {left: {from: relay, depth: 4}, right: {from: ticker.roi, depth: 4}}
"""
    )
    plan = plan_of(tmp_path, text)

    def freeze_and_kill(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "pair") > 5)
        os.kill(supervisor.pid("work"), signal.SIGSTOP)  # frames pile up before it
        end = time.monotonic() + 0.3
        wait_for(supervisor, lambda: time.monotonic() > end)
        os.kill(supervisor.pid("work"), signal.SIGKILL)
        wait_for(supervisor, lambda: bool(supervisor.restarts), 30)
        again = handled(supervisor, "pair")
        wait_for(supervisor, lambda: handled(supervisor, "pair") > again + 10, 30)
        supervisor.finish()

    report = go(plan, 0, freeze_and_kill)

    assert edge(report, "work.frame")["lost_in_crash"] > 0
    assert edge(report, "pair.right")["dropped"]["unmatched"] > 0
    assert_accounts_add_up(report)


def test_a_graph_runs_once_at_a_time(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOOP)

    with Supervisor(plan), pytest.raises(RunError, match="already running"):
        Supervisor(plan)


def test_a_reader_without_shared_memory_gets_the_bytes(tmp_path: Path) -> None:
    text = CHAIN.replace("depth: 60", "depth: 60, transport: bytes")

    report = go(plan_of(tmp_path, text), 60)

    assert report["summaries"]["count"] == {"seen": list(range(60)), "torn": 0}
    assert_accounts_add_up(report)


def test_operators_of_a_group_share_a_process(tmp_path: Path) -> None:
    text = LOOP.replace("  work:\n", "  work:\n    group: hand\n")
    text = text.replace("  pair:\n", "  pair:\n    group: hand\n")
    plan = plan_of(tmp_path, text)
    assert set(plan.processes()) == {"ticker", "hand", "steer"}

    report = go(plan, 60)

    assert report["loop"]["commands"] > 20  # of 60; a busy machine leaves some out
    assert_accounts_add_up(report)


def test_a_killed_supervisor_takes_its_children_along_and_the_next_start_sweeps(
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

    gone, alive = psutil.wait_procs(children, timeout=6)
    assert (len(gone), alive) == (4, [])
    assert plan.name not in running()
    go(plan, 5)
    assert not path_of(facts["run"]).exists()
