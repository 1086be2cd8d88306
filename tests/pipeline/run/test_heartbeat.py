"""A watchdog outside sees from one file whether a run is alive and whether all of it runs."""

import errno
import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.run.heartbeat import EVERY_S, Heartbeat
from tests.sample_graphs import until

GRAPH = """
name: alive
nodes:
  capture:
    operator: tests.samples:Ticker
    settings: {rate_hz: 30}
  count:
    operator: tests.samples:Count
    inputs: {frame: capture.context}
"""


def test_it_is_renewed_once_a_second_and_at_once_when_its_text_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, file = 100.0, tmp_path / "heartbeat"
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    with Heartbeat(file) as heartbeat:
        heartbeat.beat(works=False)
        assert file.read_text() == "starting\n"
        heartbeat.beat(works=True)
        assert file.read_text() == "running\n"

        os.utime(file, (0, 0))
        now_s += EVERY_S / 2
        heartbeat.beat(works=True)
        assert file.stat().st_mtime == 0
        now_s += EVERY_S / 2
        heartbeat.beat(works=True)
        assert file.stat().st_mtime > 0

        first = file.stat().st_ino
        heartbeat.beat(works=False)
        assert file.stat().st_ino != first  # replaced in one step: nobody reads half a word
    assert not list(tmp_path.iterdir())


def test_on_a_full_disk_it_is_renewed_and_a_removed_file_is_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    now_s, file = 100.0, tmp_path / "heartbeat"
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    with Heartbeat(file) as heartbeat:
        heartbeat.beat(works=True)
        os.utime(file, (0, 0))
        with monkeypatch.context() as patch:
            patch.setattr("pipeline.run.heartbeat.write_whole", full)
            now_s += EVERY_S
            heartbeat.beat(works=True)
            assert file.stat().st_mtime > 0
            heartbeat.beat(works=False)  # another text needs space
        assert [said.endswith("No space left on device") for said in caplog.messages] == [True]
        heartbeat.beat(works=False)
        assert file.read_text() == "starting\n"

        file.unlink()
        now_s += EVERY_S
        heartbeat.beat(works=False)
        assert file.read_text() == "starting\n"


def test_a_folder_that_is_gone_is_told_once_and_ends_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with Heartbeat(tmp_path / "gone" / "heartbeat") as heartbeat, caplog.at_level(logging.ERROR):
        for works in (False, True, False):
            heartbeat.beat(works=works)

    (said,) = caplog.messages
    assert said.endswith("heartbeat: cannot be written: No such file or directory")


def test_without_a_path_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    with Heartbeat(None) as heartbeat:
        heartbeat.beat(works=True)

    assert not list(tmp_path.iterdir())


def test_a_run_renews_its_file_until_it_is_frozen_and_removes_it(tmp_path: Path) -> None:
    graph, file = tmp_path / "graph.yaml", tmp_path / "heartbeat"
    graph.write_text(GRAPH)
    words = ["run", str(graph), "--heartbeat", str(file)]
    with subprocess.Popen([sys.executable, "-m", "pipeline.entry", *words]) as process:
        until(lambda: file.exists() and file.read_text() == "running\n")
        first = file.stat().st_mtime_ns
        until(lambda: file.stat().st_mtime_ns > first)

        os.kill(process.pid, signal.SIGSTOP)
        frozen = file.stat().st_mtime_ns
        time.sleep(1.5 * EVERY_S)
        assert file.stat().st_mtime_ns == frozen
        os.kill(process.pid, signal.SIGCONT)
        until(lambda: file.stat().st_mtime_ns > frozen)

        os.kill(process.pid, signal.SIGINT)
    assert not file.exists()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--heartbeat", "missing/heartbeat"], "--heartbeat missing/heartbeat: cannot be written"),
        (["--heartbeat", "heartbeat", "--inline"], "--heartbeat: goes with processes"),
    ],
)
def test_a_heartbeat_that_cannot_be_is_refused_first(
    more: list[str], said: str, tmp_path: Path
) -> None:
    (tmp_path / "graph.yaml").write_text(GRAPH)
    words = [sys.executable, "-m", "pipeline.entry", "run", "graph.yaml", *more]

    done = subprocess.run(
        words, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )

    assert done.returncode == 2
    assert said in done.stderr
