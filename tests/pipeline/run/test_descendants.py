"""What a node started ends with the node, holds nobody up, and nothing else is touched."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.protocol.supervision import Uncut
from pipeline.run.descendants import TAG_VARIABLE, end_tagged, new_tag, tagged
from pipeline.run.leftovers import cleanup
from pipeline.run.rundir import running
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import (
    KILLED,
    assert_accounts_add_up,
    ended,
    go,
    send_signal,
    until,
    wait_for,
)
from tests.unruly_graphs import recovers, unruly_plan


def noted(note: Path, count: int) -> list[int]:
    """The process ids in a file, once there are so many."""
    until(lambda: note.exists() and len(note.read_text().splitlines()) >= count)
    return [int(line) for line in note.read_text().splitlines()]


@pytest.mark.parametrize("kind", ["fork_and_die", "leave_session"])
def test_a_child_that_outlives_its_node_holds_nobody_up_and_is_ended(
    tmp_path: Path, kind: str
) -> None:
    note = tmp_path / "pids"
    plan = unruly_plan(tmp_path, kind=kind, note=note, once=tmp_path / "once")

    report = go(plan, 0, recovers)

    assert report["failure"] == ""
    assert report["restarts"] == {"unruly": 1}
    assert_accounts_add_up(report)
    until(lambda: all(ended(pid) for pid in noted(note, 1)))


@pytest.mark.parametrize(("kind", "count"), [("fork_many", 2), ("start_session", 1)])
def test_what_a_node_started_ends_with_the_run(tmp_path: Path, kind: str, count: int) -> None:
    note = tmp_path / "pids"
    plan = unruly_plan(tmp_path, kind=kind, note=note, once=tmp_path / "once")
    pids: list[int] = []

    def during(supervisor: Supervisor) -> None:
        wait_for(supervisor, lambda: note.exists() and len(note.read_text().split()) >= count, 60)
        pids.extend(noted(note, count))
        assert not any(ended(pid) for pid in pids)
        supervisor.finish()

    go(plan, 0, during)

    until(lambda: all(ended(pid) for pid in pids))


@pytest.mark.parametrize(("kind", "count"), [("fork_many", 2), ("start_session", 1)])
def test_what_nodes_of_a_killed_supervisor_started_ends_with_them_or_with_the_next_cleanup(
    tmp_path: Path, kind: str, count: int
) -> None:
    note = tmp_path / "pids"
    plan = unruly_plan(tmp_path, kind=kind, note=note, once=tmp_path / "once")
    graph, settings = tmp_path / "graph.yaml", f"{{kind: {kind}, note: {note}}}"
    operator = "    operator: tests.faulty_samples:Unruly\n"
    graph.write_text(graph.read_text().replace(operator, f"{operator}    settings: {settings}\n"))
    with subprocess.Popen([sys.executable, "-c", KILLED, str(graph)]) as supervisor:
        pids = noted(note, count)
        nodes = list(running()[plan.name]["pids"].values())

        supervisor.kill()

    until(lambda: all(ended(pid) for pid in nodes))
    cleanup()
    until(lambda: all(ended(pid) for pid in pids))


def test_only_what_carries_the_mark_is_ended() -> None:
    tag, other = new_tag("fovea-test-"), new_tag("fovea-test-")
    tags = {"mine": tag, "other": other, "longer": f"x{tag}"}
    started = {
        name: subprocess.Popen(["sleep", "1000"], env={**os.environ, TAG_VARIABLE: value})
        for name, value in tags.items()
    }
    try:
        until(lambda: list(tagged(tag)) == [started["mine"].pid])

        assert end_tagged(tag) == 1

        assert started["mine"].wait(10) == -signal.SIGKILL
        assert [started[name].poll() for name in ("other", "longer")] == [None, None]
        assert end_tagged("") == 0
    finally:
        for process in started.values():
            process.kill()
            process.wait()


def test_a_process_never_ends_itself() -> None:
    words = "from pipeline.run.descendants import end_tagged; print(end_tagged('fovea-own-'))"
    tag = new_tag("fovea-own-")

    done = subprocess.run(
        [sys.executable, "-c", words], env={**os.environ, TAG_VARIABLE: tag},
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip

    assert (done.returncode, done.stdout) == (0, "0\n"), done.stderr


def test_a_tick_never_waits_for_a_stopped_node_that_is_told_more_than_its_socket_holds(
    tmp_path: Path,
) -> None:
    plan = unruly_plan(tmp_path)
    longest: list[float] = []

    def during(supervisor: Supervisor) -> None:
        send_signal(supervisor, "unruly", signal.SIGSTOP)
        handle = supervisor.processes["unruly"].handle
        assert handle is not None
        for _ in range(20):
            began_s = time.monotonic()
            handle.tell(Uncut("x" * 1_000_000))
            supervisor.tick()
            longest.append(time.monotonic() - began_s)
        recovers(supervisor)

    report = go(plan, 0, during)

    assert max(longest) < 30  # who waits does so until the node is continued
    assert report["failure"] == ""
