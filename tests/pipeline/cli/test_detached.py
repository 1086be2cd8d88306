"""A detached run goes on after its command has ended, and its end is recorded."""

import contextlib
import json
import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from pipeline.client import detached
from pipeline.errors import RunError
from pipeline.node.logfile import MOST_BYTES
from pipeline.run.run_folder import RunFolder
from pipeline.run.rundir import folder_of, running
from tests.commands import command
from tests.sample_graphs import CHAIN, together, until

FOVEA = (sys.executable, "-m", "pipeline.entry")


FORKING = """
import os, time
from tests.samples import Pass as More

if not (pid := os.fork()):
    time.sleep(300)
    os._exit(0)
with open({pids!r}, "a") as file:
    print(pid, file=file)
if {wrong}:
    raise ValueError("wrong on purpose")
"""


def fovea(
    *words: str, cwd: Path | None = None, quiet: bool = False
) -> "subprocess.CompletedProcess[str]":
    """Run the command to its end; `quiet` where processes that it leaves hold its streams open."""
    pipe = subprocess.DEVNULL if quiet else subprocess.PIPE
    return subprocess.run(
        [*FOVEA, *words], stdout=pipe, stderr=pipe, cwd=cwd, text=True, timeout=120, check=False
    )


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: detach-{secrets.token_hex(3)}\n{together(CHAIN, 'ticker', 'glance')}")
    return path


@pytest.fixture
def name(graph: Path) -> Iterator[str]:
    name = graph.read_text().split()[1]
    yield name
    if name in running():  # a test that failed
        psutil.Process(running()[name]["pid"]).kill()


def runs(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_an_order_to_a_graph_whose_process_is_stopped_tells_so_and_waits_for_it(
    graph: Path, name: str
) -> None:
    assert fovea("run", str(graph), "--detach").returncode == 0
    pid = running()[name]["pid"]
    os.kill(pid, signal.SIGSTOP)

    with subprocess.Popen([*FOVEA, "stop", name], stderr=subprocess.PIPE, text=True) as stopping:
        assert stopping.stderr is not None
        try:
            told = stopping.stderr.readline()
        finally:
            os.kill(pid, signal.SIGCONT)

    assert f"waits for process {pid}, which runs it and is stopped: kill -CONT {pid}" in told
    assert stopping.returncode == 0
    until(lambda: not runs(pid))


def test_a_detached_run_goes_on_and_is_stopped_with_its_report(graph: Path, name: str) -> None:
    begun = fovea("run", str(graph), "--detach", "--json")
    where = json.loads(begun.stdout)
    (pids,) = [running()[name]["pids"]]
    again = fovea("run", str(graph), "--detach")
    stopped = command("stop", name, "--json")
    afterwards = command("stop", name, "--json")

    assert begun.returncode == 0, begun.stderr
    assert where["graph"] == name
    assert set(pids) == {"hand", "count"}
    assert again.returncode == 1
    assert "already running" in again.stderr
    assert json.loads(stopped.stdout)["exit_status"] == 0, stopped.stderr
    assert json.loads(afterwards.stdout) == json.loads(stopped.stdout) | {"stopped": False}
    until(lambda: not runs(where["pid"]))
    report = json.loads(Path(json.loads(stopped.stdout)["report"]).read_text())
    assert report["graph"] == name
    assert "rate:" in command("logs", name).stdout
    assert json.loads(command("ps", "--json").stdout)[name]["ended"]["exit_status"] == 0
    assert f"{name}: ended" in command("ps").stdout
    assert f"{name}: ended" in command("stop", name).stdout


def test_what_a_detached_run_prints_is_bounded_and_its_end_is_shown(graph: Path, name: str) -> None:
    words = Path(json.loads(fovea("run", str(graph), "--detach", "--json").stdout)["words"])
    with words.open("ab") as file:
        file.write(b"a line of words\n" * (MOST_BYTES // 16 + 1))
    shown = command("logs", name, "--lines", "2")
    cut = detached.words(name, 10**6)
    stopped = command("stop", name)

    assert shown.stdout == "a line of words\n" * 2, shown.stderr
    assert set(cut) == {"a line of words"}
    assert stopped.returncode == 0, stopped.stderr
    assert words.with_name("run.out.old").stat().st_size > MOST_BYTES
    assert words.stat().st_size < 100_000
    assert "rate:" in command("logs", name).stdout


def test_output_that_cannot_be_read_is_an_error_with_the_reason(name: str) -> None:
    folder = folder_of(name)
    folder.mkdir(mode=0o700)
    with pytest.raises(RunError, match=r": no detached run wrote anything$"):
        detached.words(name, 5)
    (folder / detached.WORDS).symlink_to("/etc/hostname")

    with pytest.raises(RunError, match=r": run\.out: cannot be read: "):
        detached.words(name, 5)


def test_a_run_after_a_detached_one_takes_its_place(graph: Path, name: str) -> None:
    fovea("run", str(graph), "--detach")
    stopped = command("stop", name)
    after = fovea("run", str(graph), "--frames", "5")

    assert stopped.returncode == after.returncode == 0, after.stderr
    assert detached.noted(name) is None
    assert f"no graph {name} runs" in command("stop", name).stderr
    assert f"got {name} alone" in command("logs", name).stderr
    assert name not in command("ps").stdout
    assert not {detached.WORDS, detached.RECORD, detached.REPORT} & set(os.listdir(folder_of(name)))


def test_the_end_of_a_run_is_not_noted_when_another_has_begun(name: str) -> None:
    RunFolder.claim(name).release()
    first = detached.begin(name, "0" * 16, 1)
    RunFolder.claim(name).release()
    detached.end(first, 0, "", {"graph": name})
    left = os.listdir(folder_of(name))
    second = detached.begin(name, "1" * 16, 2)
    detached.end(first, 0, "", {"graph": name})

    assert left == ["lock"]
    assert detached.noted(name) == second


def test_a_run_that_ends_by_itself_leaves_its_status(graph: Path, name: str) -> None:
    begun = fovea("run", str(graph), "--detach", "--set", "ticker.fail_at=30")

    assert begun.returncode == 0, begun.stderr
    until(lambda: (found := detached.noted(name)) is not None and found.ended)
    found = detached.noted(name)
    assert found is not None
    assert (found.exit_status, found.why) == (2, "picture 30: torn")


def test_a_killed_run_is_reported_as_killed(graph: Path, name: str) -> None:
    pid = json.loads(fovea("run", str(graph), "--detach", "--json").stdout)["pid"]
    os.kill(pid, signal.SIGKILL)
    until(lambda: name not in running())

    assert command("stop", name).stdout == f"{name}: was killed\n"
    assert f"\n{name}: was killed\n" in command("ps").stdout


def test_a_detached_run_that_cannot_begin_is_an_error_of_its_command(
    graph: Path, name: str
) -> None:
    wrong = command("run", str(graph), "--detach", "--set", "ticker.fail_a=3")
    both = command("run", str(graph), "--detach", "--inline")

    assert (wrong.returncode, both.returncode) == (2, 2)
    assert "did you mean 'fail_at'" in wrong.stderr
    assert "--detach and --inline: give one of them" in both.stderr
    assert detached.noted(name) is None


@pytest.mark.parametrize("wrong", [False, True])
def test_a_process_that_a_module_forks_on_import_is_not_waited_for(
    graph: Path, name: str, tmp_path: Path, wrong: bool
) -> None:
    pids = tmp_path / "pids"
    (tmp_path / "forking.py").write_text(FORKING.format(pids=str(pids), wrong=wrong))
    with graph.open("a") as file:
        file.write("  more:\n    operator: forking:More\n    inputs: {frame: ticker.roi}\n")
    try:
        begun = fovea("run", "graph.yaml", "--detach", cwd=tmp_path, quiet=True)

        assert begun.returncode == (2 if wrong else 0)
        assert (name in running()) is not wrong
        assert wrong or command("stop", name).returncode == 0
    finally:
        for pid in pids.read_text().split():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGKILL)


def test_attach_watches_until_ctrl_c_and_the_graph_goes_on(graph: Path, name: str) -> None:
    fovea("run", str(graph), "--detach")
    shown = json.loads(command("attach", name, "--json").stdout)
    watching = subprocess.Popen([*FOVEA, "attach", name], stdout=subprocess.PIPE, text=True)
    assert watching.stdout is not None
    assert watching.stdout.readline() == f"{name}: Ctrl-C leaves it running\n"
    watching.send_signal(signal.SIGINT)
    said = watching.communicate(timeout=60)[0]

    assert shown["hosts"][""][0]["phase"] == "running"
    assert watching.returncode == 0
    assert said.strip() == f"{name}: goes on; `fovea stop {name}` ends it"
    assert name in running()
    assert command("stop", name).returncode == 0


@pytest.mark.lengthy
def test_stop_and_down_also_end_a_run_in_the_foreground(graph: Path, name: str) -> None:
    for verb in ("stop", "down"):
        run = subprocess.Popen([*FOVEA, "run", str(graph)], stdout=subprocess.PIPE, text=True)
        until(lambda: name in running() and not command("health", name).returncode)

        stopped = command(verb, name)

        assert stopped.stdout == f"{name}: stopped\n", stopped.stderr
        assert "rate:" in run.communicate(timeout=60)[0]
        assert run.returncode == 0


def test_a_graph_that_does_not_run_cannot_be_stopped_or_watched() -> None:
    for verb in ("stop", "down", "attach"):
        done = command(verb, "nowhere-at-all")

        assert done.returncode == 1
        assert "no graph nowhere-at-all runs" in done.stderr


@pytest.mark.parametrize("data", [b"", b"{}", b"[1]", b'{"graph": 3}', b"\xff", b"{" * 3000])
def test_a_record_that_no_run_wrote_is_ignored(data: bytes) -> None:
    folder = folder_of(f"noise-{secrets.token_hex(3)}")
    folder.mkdir(mode=0o700)
    (folder / detached.RECORD).write_bytes(data)

    assert detached.noted(folder.name) is None
    assert folder.name not in detached.all_noted()


def test_ps_prints_a_sentence_where_no_graph_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))

    assert fovea("ps").stdout == "no graph runs\n"
