"""Processes that a node started end with it and delay nothing; no others are touched."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from pipeline.process_tree import children, descendants, end
from pipeline.protocol.supervision import Uncut
from pipeline.run.descendants import TAG_VARIABLE, end_tagged, new_tag, tagged
from pipeline.run.leftovers import cleanup
from pipeline.run.rundir import running
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import (
    KILLED,
    assert_accounts_add_up,
    beside,
    ended,
    go,
    plan_of,
    send_signal,
    until,
    wait_for,
)
from tests.unruly_graphs import (
    all_recover,
    recovers,
    unruly_file,
    unruly_parts,
    unruly_plan,
)

FOVEA = (sys.executable, "-m", "pipeline.entry")


KINDS = {"fork_many": 2, "start_session": 1, "escape": 1, "escape_twice": 1}  # number of processes
REAPING = """
import os, subprocess, sys
from pipeline.run.reaper import Reaper
SLEEP = ["sleep", "1000"]
ESCAPER = "import subprocess; "
ESCAPER += "print(subprocess.Popen(['sleep', '1000'], start_new_session=True, env={}).pid)"
before = subprocess.Popen(SLEEP, start_new_session=True)
reaper = Reaper()
mine = subprocess.Popen(SLEEP)
words = [sys.executable, "-c", ESCAPER]
node = reaper.start(
    lambda: subprocess.Popen(words, start_new_session=True, stdout=subprocess.PIPE)
)
working = reaper.start(lambda: subprocess.Popen(SLEEP, start_new_session=True))
orphan = int(node.stdout.readline())
node.wait()
reaper.forget(node.pid)
print(reaper.end(), reaper.end(), os.path.exists(f"/proc/{orphan}"))
print([process.poll() for process in (before, mine, working)])
for process in (before, mine, working):
    process.kill()
"""
FIRST = """
import os, subprocess
from pathlib import Path
from pipeline.run.reaper import Reaper
reaper = Reaper()
script = "setsid sleep 1000 > /dev/null & echo $!"
said = subprocess.run(["sh", "-c", script], stdout=subprocess.PIPE, check=True).stdout
orphan = Path(f"/proc/{int(said)}")
parent = (orphan / "stat").read_text().split()[3]
print(os.getpid(), parent, reaper.end(), orphan.exists())
"""


def noted(note: Path, count: int) -> list[int]:
    """Wait until a file has so many process ids; return them."""
    until(lambda: note.exists() and len(note.read_text().splitlines()) >= count)
    return [int(line) for line in note.read_text().splitlines()]


def notes_of(folder: Path, kinds: Mapping[str, int]) -> dict[str, list[int]]:
    """Wait until each unruly part has started all its processes; return their ids."""
    return {name: noted(folder / f"note-{name}", count) for name, count in kinds.items()}


def test_children_that_outlive_their_nodes_hold_nobody_up_and_are_ended(tmp_path: Path) -> None:
    kinds = ("fork_and_die", "leave_session")
    plan = plan_of(tmp_path, unruly_parts(tmp_path, {kind: kind for kind in kinds}))

    report = go(plan, 0, lambda supervisor: all_recover(supervisor, kinds))

    assert report["failure"] == ""
    assert report["restarts"] == dict.fromkeys(kinds, 1)
    assert_accounts_add_up(report)
    for kind, pids in notes_of(tmp_path, dict.fromkeys(kinds, 1)).items():
        until(lambda pids=pids: all(ended(pid) for pid in pids), what=kind)  # type: ignore[misc]


@pytest.mark.lengthy
def test_what_nodes_started_ends_with_the_run(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, unruly_parts(tmp_path, {kind: kind for kind in KINDS}))
    pids: dict[str, list[int]] = {}

    def during(supervisor: Supervisor) -> None:
        pids.update(beside(supervisor, lambda: notes_of(tmp_path, KINDS)))
        assert not any(ended(pid) for each in pids.values() for pid in each)
        supervisor.finish()

    go(plan, 0, during)

    for kind, each in pids.items():
        until(lambda each=each: all(ended(pid) for pid in each), what=kind)  # type: ignore[misc]


def test_what_nodes_of_a_killed_supervisor_started_ends_with_them_or_with_the_next_cleanup(
    tmp_path: Path,
) -> None:
    plan = plan_of(tmp_path, unruly_parts(tmp_path, {kind: kind for kind in KINDS}))
    command = [sys.executable, "-c", KILLED, str(tmp_path / "graph.yaml")]
    with subprocess.Popen(command) as supervisor:
        try:
            pids = notes_of(tmp_path, KINDS)
            nodes = list(running()[plan.name]["pids"].values())
        finally:
            supervisor.kill()

    until(lambda: all(ended(pid) for pid in nodes))
    cleanup()
    for kind, each in pids.items():
        until(lambda each=each: all(ended(pid) for pid in each), what=kind)  # type: ignore[misc]


@pytest.mark.lengthy
def test_what_a_killed_node_started_ends_however_it_tried_to_leave(tmp_path: Path) -> None:
    killers = {"ours": "the supervisor", "theirs": "another"}
    kinds = {f"{kind}_{who}": kind for kind in ("escape", "escape_twice") for who in killers}
    plan = plan_of(tmp_path, unruly_parts(tmp_path, kinds))
    pids: dict[str, list[int]] = {}

    def during(supervisor: Supervisor) -> None:
        counts = dict.fromkeys(kinds, 1)
        pids.update(beside(supervisor, lambda: notes_of(tmp_path, counts)))
        managed = [supervisor.processes[name] for name in kinds]
        seen = [
            len(one.samples) for one in managed
        ]  # each sample looks for processes that a node started
        wait_for(
            supervisor,
            lambda: all(len(one.samples) > n for one, n in zip(managed, seen, strict=True)),
        )
        for name, one in zip(kinds, managed, strict=True):
            if name.endswith("_ours"):
                assert one.handle is not None
                one.handle.kill()
            else:
                send_signal(supervisor, name, signal.SIGKILL)
        all_recover(supervisor, kinds)

    go(plan, 0, during)

    for name, each in pids.items():
        until(lambda each=each: all(ended(pid) for pid in each), what=name)  # type: ignore[misc]


def test_a_command_ends_and_waits_for_what_a_node_left_behind_the_moment_it_died(
    tmp_path: Path,
) -> None:
    note, once = tmp_path / "pids", tmp_path / "once"
    graph = unruly_file(tmp_path, kind="escape_and_die", note=note, once=once)
    with subprocess.Popen([*FOVEA, "run", str(graph)], stdout=subprocess.DEVNULL) as command:
        try:
            (pid,) = noted(note, 1)

            until(lambda: not psutil.pid_exists(pid))  # no zombie either

            assert command.poll() is None
        finally:
            command.terminate()


def test_no_child_of_the_process_itself_is_taken_for_an_orphan_of_a_node() -> None:
    done = subprocess.run(
        [sys.executable, "-c", REAPING], capture_output=True, text=True, timeout=60, check=True
    )

    assert done.stdout.splitlines() == ["1 0 False", "[None, None, None]"]


def test_the_first_process_of_a_container_ends_no_orphan_of_another(tmp_path: Path) -> None:
    own = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc"]
    if shutil.which("unshare") is None or subprocess.run([*own, "true"], check=False).returncode:
        pytest.skip("process namespaces are not permitted here")

    done = subprocess.run(
        [*own, sys.executable, "-c", FIRST], capture_output=True, text=True, timeout=60, check=True
    )

    assert done.stdout == "1 1 0 True\n"


def test_a_process_that_got_the_number_of_another_is_not_ended() -> None:
    with subprocess.Popen(["sleep", "1000"]) as process:
        (member,) = (m for m in children(os.getpid()) if m.pid == process.pid)

        assert end([replace(member, started=member.started - 1)]) == 0
        assert process.poll() is None
        assert end([member]) == 1

        assert process.wait(10) == -signal.SIGKILL


def test_a_whole_tree_is_ended() -> None:
    script = "(setsid sh -c 'sleep 1000 & sleep 1000; true' & sleep 1000; true) & wait"
    with subprocess.Popen(["sh", "-c", script]) as process:
        until(lambda: len(descendants(process.pid)) == 5)
        (member,) = (m for m in children(os.getpid()) if m.pid == process.pid)
        below = descendants(process.pid)

        count = end([member, *below])

    assert count == 6
    until(lambda: all(ended(m.pid) for m in below))


def test_only_processes_with_the_tag_are_ended() -> None:
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


def test_a_tick_never_waits_for_a_stopped_node_that_is_sent_more_than_its_socket_holds(
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

    assert max(longest) < 5  # a tick that waits does so until the node is continued
    assert report["failure"] == ""
