"""Ctrl-C, SIGTERM and a closed terminal end everything, at any moment, and leave nothing behind."""

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from bench.leftovers import leftover_files
from pipeline.client.find import find
from pipeline.errors import FoveaError
from pipeline.run.memory_folder import path_of
from pipeline.run.rundir import base, running
from tests.sample_graphs import LOOP, ended, together, until
from tests.unruly_graphs import UNRULY, name_of, unruly_file

FOVEA = (sys.executable, "-m", "pipeline.entry")
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
SLOW_TOO = pytest.mark.slow  # cases that differ from a usual one by the signal or moment alone
LIMIT_S = 20  # drain and stop take 10 s at most, on an idle machine 0.3 to 3.3 s
# two processes end as four do, and take half the time to start
PAIRED = together(LOOP, "work", "pair", "steer")
SLOW = together(LOOP, "pair", "steer").replace(
    "    operator: tests.samples:Pass\n",
    "    operator: tests.faulty_samples:Sick\n    settings: {open_s: 600}\n    start_s: 600\n",
)
CRASHING = UNRULY.replace("backoff_s: 0.01", "backoff_s: 0.01, most: 10000").replace(
    "    operator: tests.faulty_samples:Unruly\n",
    "    operator: tests.faulty_samples:Unruly\n    settings: {kind: exit_in_open}\n",
)


def written(tmp_path: Path, text: str) -> Path:
    return unruly_file(tmp_path, text=text)


@contextmanager
def fovea(*words: str) -> Iterator["subprocess.Popen[str]"]:
    """Run the command in a session of its own."""
    with no_signal_ignored():
        process = subprocess.Popen(
            [*FOVEA, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            start_new_session=True,
        )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@contextmanager
def no_signal_ignored() -> Iterator[None]:
    """Restore the default handlers meanwhile: a child inherits ignored signals, as of nohup."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def ends(process: "subprocess.Popen[str]", *numbers: int) -> str:
    """Send signals one after the other; return the output of the process, which ends soon."""
    for number in numbers:
        process.send_signal(number)
        time.sleep(0.2)
    out, err = process.communicate(timeout=LIMIT_S)
    assert "Traceback" not in out + err, out + err
    assert process.returncode == 128 + numbers[0], out + err
    return out + err


def works(name: str) -> bool:
    """Return whether every node of a graph answers."""
    try:
        return all(find(name).health().values())
    except FoveaError:  # it has not come up yet
        return False


def nodes_of(name: str) -> list[int]:
    pids: dict[str, int] = running().get(name, {}).get("pids", {})
    return list(pids.values())


def assert_nothing_left(name: str, run_id: str, pids: list[int]) -> None:
    assert leftover_files(base() / name) == []
    assert not path_of(run_id).exists()
    until(lambda: all(ended(pid) for pid in pids))


@pytest.mark.parametrize(
    ("text", "number"),
    [
        pytest.param(LOOP, signal.SIGINT, id="running-2"),
        *(pytest.param(PAIRED, number, id=f"running-{number}") for number in SIGNALS[1:]),
        pytest.param(SLOW, signal.SIGINT, id="starting-2"),
        pytest.param(SLOW, signal.SIGTERM, id="starting-15", marks=SLOW_TOO),
        pytest.param(SLOW, signal.SIGHUP, id="starting-1", marks=SLOW_TOO),
        pytest.param(CRASHING, signal.SIGTERM, id="crashing-15"),
        pytest.param(CRASHING, signal.SIGINT, id="crashing-2", marks=SLOW_TOO),
        pytest.param(CRASHING, signal.SIGHUP, id="crashing-1", marks=SLOW_TOO),
    ],
)
def test_a_signal_ends_a_graph_in_whatever_state_it_is(
    tmp_path: Path, number: int, text: str
) -> None:
    graph, report = written(tmp_path, text), tmp_path / "report.json"
    name = name_of(graph)
    goal = {LOOP: 4, PAIRED: 2, SLOW: 3, CRASHING: 1}[text]
    with fovea("run", str(graph), "--report", str(report)) as process:
        until(lambda: len(nodes_of(name)) >= goal)
        if text in (LOOP, PAIRED):
            until(lambda: works(name))
        pids, run_id = nodes_of(name), running()[name]["run"]

        said = ends(process, number)

    assert "losses: " in said
    assert {"edges", "stages"} <= set(json.loads(report.read_text()))
    assert_nothing_left(name, run_id, pids)


@pytest.mark.parametrize("count", [2, 3])
def test_a_second_signal_waits_for_nothing_and_leaves_nothing(tmp_path: Path, count: int) -> None:
    text = PAIRED.replace("tests.samples:Pair", "tests.faulty_samples:Clinging")
    graph, report = written(tmp_path, text), tmp_path / "report.json"
    name = name_of(graph)
    with fovea("run", str(graph), "--report", str(report)) as process:
        until(lambda: len(nodes_of(name)) == 2)
        pids, run_id = nodes_of(name), running()[name]["run"]

        said = ends(process, *[signal.SIGINT] * count)

    assert "hand:" not in said  # neither that it was killed late, nor that it left by itself
    assert report.exists()
    assert_nothing_left(name, run_id, pids)


@pytest.mark.parametrize(
    ("after_s", "number"),
    [
        pytest.param(after_s, number, marks=[] if (moment - turn) % 3 == 0 else SLOW_TOO)
        for moment, after_s in enumerate([0.1, 0.3, 0.6, 1.0, 1.5])
        for turn, number in enumerate(SIGNALS)
    ],
)
def test_a_signal_while_the_command_comes_up_ends_it_without_a_traceback(
    tmp_path: Path, number: int, after_s: float
) -> None:
    graph = written(tmp_path, PAIRED)
    with fovea("run", str(graph)) as process:
        until(lambda: answers_signals(process.pid))
        time.sleep(after_s)

        ends(process, number)

    folder = base() / name_of(graph)
    assert not folder.exists() or leftover_files(folder) == []


def answers_signals(pid: int) -> bool:
    """Return whether a process has handlers for all three signals."""
    status = Path(f"/proc/{pid}/status").read_text()
    caught = int(status.partition("SigCgt:")[2].split()[0], 16)
    return all(caught >> (number - 1) & 1 for number in SIGNALS)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_ends_an_inline_run_and_its_report_is_written(tmp_path: Path, number: int) -> None:
    note, report = tmp_path / "note", tmp_path / "report.json"
    graph = unruly_file(tmp_path, kind="tell", note=note, once=tmp_path / "once")
    with fovea("run", str(graph), "--inline", "--report", str(report)) as process:
        until(note.exists)

        said = ends(process, number)

    assert "losses: " in said
    assert json.loads(report.read_text())["frames"]["exposed"] > 10


@pytest.mark.parametrize("count", [1, 2])
def test_a_signal_ends_an_inline_run_that_hangs_in_a_handler(tmp_path: Path, count: int) -> None:
    note, report = tmp_path / "note", tmp_path / "report.json"
    graph = unruly_file(tmp_path, kind="hang", note=note)
    with fovea("run", str(graph), "--inline", "--report", str(report)) as process:
        until(note.exists)

        ends(process, *[signal.SIGINT] * count)

    assert len(json.loads(report.read_text())["stages"]) == 3


def test_an_operator_of_an_inline_run_that_exits_is_an_error(tmp_path: Path) -> None:
    graph = unruly_file(tmp_path, kind="system_exit")
    with fovea("run", str(graph), "--inline") as process:
        _, err = process.communicate(timeout=60)

    assert process.returncode == 2
    assert err.startswith("Error: unruly: ")
    assert err.endswith(": it exits: 0\n")


@pytest.fixture(scope="module")
def looked_at(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Run a graph for commands that only look; yield its name. It leaves nothing behind."""
    text = PAIRED.replace("rate_hz: 60", "rate_hz: 20")
    graph = written(tmp_path_factory.mktemp("looked-at"), text)
    name = name_of(graph)
    with fovea("run", str(graph)) as process:
        until(lambda: works(name))
        yield name
        ends(process, signal.SIGTERM)
    assert leftover_files(base() / name) == []


@pytest.mark.parametrize(
    ("words", "number"),
    [
        pytest.param(words, number, marks=[] if row == column else SLOW_TOO)
        for row, words in enumerate(
            [("top", "NAME"), ("echo", "NAME", "steer"), ("logs", "NAME", "work", "-f")]
        )
        for column, number in enumerate(SIGNALS)
    ],
)
def test_a_signal_ends_a_command_that_looks(
    looked_at: str, number: int, words: tuple[str, ...]
) -> None:
    with fovea(*(looked_at if word == "NAME" else word for word in words)) as looking:
        assert looking.stdout is not None
        until(lambda: answers_signals(looking.pid))
        select.select([looking.stdout], [], [], 2)  # its first output, where there is some
        assert looking.poll() is None

        ends(looking, number)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_ends_an_agent_with_exit_status_0(tmp_path: Path, number: int) -> None:
    with fovea("agent", "--label", "here", "--state", str(tmp_path)) as process:
        assert process.stdout is not None
        assert "listens" in process.stdout.readline()

        process.send_signal(number)
        out, err = process.communicate(timeout=60)

    assert (process.returncode, "Traceback" in out + err) == (0, False)


def test_a_closed_standard_output_does_not_end_a_graph(tmp_path: Path) -> None:
    graph, report = written(tmp_path, PAIRED), tmp_path / "report.json"
    with fovea("run", str(graph), "--frames", "200", "--report", str(report)) as process:
        assert process.stdout is not None
        process.stdout.close()
        process.stdout = None

        _, err = process.communicate(timeout=60)

    assert (process.returncode, err) == (0, "")
    assert json.loads(report.read_text())["frames"]["exposed"] == 200


def test_a_closed_standard_output_ends_a_command_that_only_shows(looked_at: str) -> None:
    with fovea("echo", looked_at, "steer") as looking:
        assert looking.stdout is not None
        assert "windows" in looking.stdout.readline()
        looking.stdout.close()
        looking.stdout = None

        _, err = looking.communicate(timeout=60)

    assert (looking.returncode, err) == (1, "")


def test_a_terminal_that_vanishes_ends_the_run_and_leaves_nothing(tmp_path: Path) -> None:
    graph, report = written(tmp_path, PAIRED), tmp_path / "report.json"
    name = name_of(graph)
    terminal, other = pty.openpty()
    os.set_blocking(terminal, False)
    with no_signal_ignored():
        process = subprocess.Popen(
            ["setsid", "--ctty", "--wait", *FOVEA, "run", str(graph), "--report", str(report)],
            stdin=other, stdout=other, stderr=other,
        )  # fmt: skip
    os.close(other)

    def has_started() -> bool:
        with suppress(BlockingIOError):  # a terminal without a reader fills up
            os.read(terminal, 4096)
        return len(nodes_of(name)) == 2

    until(has_started)
    pids, run_id = nodes_of(name), running()[name]["run"]

    os.close(terminal)

    assert process.wait(LIMIT_S) == 128 + signal.SIGHUP
    assert report.exists()
    assert_nothing_left(name, run_id, pids)


@pytest.mark.lengthy
def test_a_client_that_is_frozen_does_not_delay_the_end(tmp_path: Path) -> None:
    graph = written(tmp_path, PAIRED)
    name = name_of(graph)
    with fovea("run", str(graph)) as process:
        until(lambda: len(nodes_of(name)) == 2)
        with fovea("echo", name, "steer") as looking:
            assert looking.stdout is not None
            assert "windows" in looking.stdout.readline()
            looking.send_signal(signal.SIGSTOP)

            ends(process, signal.SIGINT)
