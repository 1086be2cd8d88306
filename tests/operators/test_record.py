"""The recorder joins a running graph, loses nothing on its lossless edges, and leaves it whole."""

import errno
import json
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap")

from operators.record import Record, RecordSettings
from pipeline import RunError, SettingsError
from pipeline.client import recording
from pipeline.client.find import find
from pipeline.client.local import LocalGraph
from pipeline.node.live import keep
from pipeline.recording.mcap_file import Item
from pipeline.recording.reader import Recording
from pipeline.recording.recorder import Recorder
from pipeline.run.inline import InlineRunner
from pipeline.run.supervisor import Supervisor
from pipeline.testing import drive
from tests.pipeline.recording.test_recorder import frame, percept
from tests.sample_graphs import (
    CHAIN,
    assert_accounts_add_up,
    beside,
    edge,
    go,
    handled,
    plan_of,
    send_signal,
    together,
    until,
    wait_for_progress,
)


def record(graph: str, path: Path, outputs: tuple[str, ...] = ()) -> recording.Outcome:
    client = find(graph)
    assert isinstance(client, LocalGraph)
    recording.begin(client, path, recording.chosen(client, outputs), {})
    return recording.follow(client, path, 1.0, lambda: 0, lambda _accounts: None)


@pytest.mark.lengthy
def test_a_running_graph_is_recorded_without_a_gap_on_a_lossless_edge(tmp_path: Path) -> None:
    plan, path, ended = plan_of(tmp_path, CHAIN), tmp_path / "a.mcap", list[recording.Outcome]()

    def look(supervisor: Supervisor) -> None:
        ended.append(beside(supervisor, lambda: record(plan.name, path)))
        supervisor.finish()

    report = go(plan, 0, look)

    found = Recording(path)
    seqs = [seq for _stream, seq in found.messages["ticker.roi"]]
    assert len(seqs) > 5
    assert seqs == list(range(seqs[0], seqs[-1] + 1))
    assert found.broken == ""
    assert [node["name"] for node in found.newest("graph")["plan"]["nodes"]][:1] == ["ticker"]
    assert found.newest("accounts")["states"]
    assert [edge.origin for edge in ended[0].accounts] == ["ticker.roi"]
    assert (ended[0].files, ended[0].failure) == ([str(path)], "")
    assert_accounts_add_up(report)


RECORDED = """\
  record:
    operator: tests.slow_disk:SlowRecord
    inputs: {frame_1: {from: ticker.roi, keep: every, depth: 4}}
    settings: {path: "PATH", queue_mb: 0.2}
"""


def test_a_disk_that_is_too_slow_holds_nothing_up_and_what_is_dropped_is_counted(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.mcap"
    text = together(CHAIN, "ticker", "count", "glance") + RECORDED.replace("PATH", str(path))

    report = go(plan_of(tmp_path, text, changes=("ticker.rate_hz=40",)), 60)

    assert_accounts_add_up(report)
    assert edge(report, "count.frame")["delivered"] == 60
    end = Recording(path).newest("end")["accounts"]["frame_1"]
    assert 0 < end["recorded"] < 60
    assert end["dropped"] > 0
    assert end["recorded"] + end["dropped"] == edge(report, "record.frame_1")["delivered"]


def test_a_recorder_that_stands_still_holds_no_writer_up(tmp_path: Path) -> None:
    text = together(CHAIN, "ticker", "count", "glance")
    text += RECORDED.replace("PATH", str(tmp_path / "a.mcap"))
    plan = plan_of(tmp_path, text, changes=("ticker.rate_hz=100",))

    def freeze(supervisor: Supervisor) -> None:
        wait_for_progress(supervisor, "record", 1)
        pid = send_signal(supervisor, "record", signal.SIGSTOP)
        before = handled(supervisor, "count")
        # ten times what may wait for it; no look at the processes, which would replace it
        until(lambda: handled(supervisor, "count") > before + 40)
        os.kill(pid, signal.SIGCONT)
        supervisor.finish()

    report = go(plan, 0, freeze)

    assert_accounts_add_up(report)
    assert sum(edge(report, "record.frame_1")["dropped"].values()) > 0


def test_a_setting_that_is_changed_is_recorded_with_the_time_of_the_change(tmp_path: Path) -> None:
    plan, path = (
        plan_of(tmp_path, together(CHAIN, "ticker", "count", "glance")),
        tmp_path / "a.mcap",
    )

    def change() -> int:
        client = find(plan.name)
        assert isinstance(client, LocalGraph)
        recording.begin(client, path, recording.chosen(client, ()), {})
        began_ns = time.time_ns()
        client.configure("ticker", {"rate_hz": 25.0})
        recording.follow(client, path, 0.5, lambda: 0, lambda _accounts: None)
        return began_ns

    def look(supervisor: Supervisor) -> None:
        times.append(beside(supervisor, change))
        supervisor.finish()

    times: list[int] = []
    go(plan, 0, look)

    (event,) = [e for e in Recording(path).facts["events"] if e["event"] == "set"]
    assert (event["node"], event["settings"]) == ("ticker", {"rate_hz": 25.0})
    assert 0 <= event["at_ns"] - times[0] < 5e9


def test_a_setting_that_is_changed_just_before_the_end_is_recorded(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = tmp_path / "graph"
    folder.mkdir(mode=0o700)
    monkeypatch.setattr("operators.record.folder_of", lambda _graph: folder)
    monkeypatch.setattr("operators.record.LIVE_S", 1000.0)  # so that only the end looks
    values = RecordSettings(path=str(tmp_path / "a.mcap"), graph="nowhere")
    subject = Record(values)
    subject.open()

    keep(folder / "ticker.live", {"rate_hz": 25.0})
    subject.close()

    (event,) = Recording(tmp_path / "a.mcap").facts["events"]
    assert (event["node"], event["settings"]) == ("ticker", {"rate_hz": 25.0})


def test_an_output_that_does_not_exist_is_named(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, CHAIN)

    def look(supervisor: Supervisor) -> None:
        with pytest.raises(RunError, match=r"ticker has no output rio, did you mean 'ticker\.roi'"):
            beside(supervisor, lambda: record(plan.name, tmp_path / "a.mcap", ("ticker.rio",)))

    go(plan, 20, look)


def test_an_input_is_recorded_under_the_output_that_it_reads(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"

    drive(Record, [{"frame_1": frame(k)} for k in range(3)],
          {"path": str(path), "outputs": {"frame_1": "capture.roi"}})  # fmt: skip

    assert list(Recording(path).messages) == ["capture.roi"]


def test_a_ring_is_written_when_the_target_is_lost(tmp_path: Path) -> None:
    seen = [percept(k) for k in range(9)]
    empty = {"boxes": np.zeros((0, 4), np.float32), "ids": np.zeros(0, np.int32),
             "scores": np.zeros(0, np.float32)}  # fmt: skip
    seen[5:] = [replace(one, **empty) for one in seen[5:]]
    values = {"path": str(tmp_path / "a.mcap"), "ring_s": 30, "lost_frames": 2}

    drive(Record, [{"percept_1": one} for one in seen], values)

    written = Recording(tmp_path / "a.mcap")
    assert "the target was lost" in json.dumps(written.facts["events"])
    assert [seq for _stream, seq in written.messages["percept_1.out"]] == list(range(7))
    assert not (tmp_path / "a-2.mcap").exists()


def test_a_ring_that_was_never_written_has_recorded_nothing(tmp_path: Path) -> None:
    subject = Record(RecordSettings(path=str(tmp_path / "a.mcap"), ring_s=30))
    subject.open()
    for seq in range(3):
        subject.take("frame_1", frame(seq))

    found = subject.summary()
    subject.close()

    assert found["headline"] == "recorded 0 messages, dropped 0, 3 passed through the ring"
    assert found["files"] == []


def test_a_recorder_without_a_file_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"^Record: path: expected a file to write, got none$"):
        drive(Record, [{"frame_1": frame(0)}], {})


NAMELESS = """\
  tape:
    operator: operators.record:Record
    inputs: {frame_1: ticker.roi}
"""


def test_a_recorder_without_a_file_is_named_as_the_graph_names_it(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, together(CHAIN, "ticker", "count", "glance") + NAMELESS)
    said = "^tape: path: expected a file to write, got none$"

    with pytest.raises(SettingsError, match=said), InlineRunner(plan):
        pass
    with pytest.raises(RunError, match=said):
        go(plan, 3)


class FullDisk(Recorder):
    """A recorder whose disk takes nothing more."""

    def _write(self, items: list[Item]) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")


class RecordOnFullDisk(Record):
    """Records to it."""

    recorder_type = FullDisk


def test_a_recording_that_cannot_be_written_to_its_end_is_named_by_its_file(
    tmp_path: Path,
) -> None:
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    summed, closed = [RecordOnFullDisk(RecordSettings(path=str(path))) for path in paths]
    for recorder in (summed, closed):
        recorder.open()
        recorder.take("frame_1", frame(0))

    told = summed.summary()

    assert told["incomplete"].startswith(f"{paths[0]}: No space left")
    with pytest.raises(RunError, match=f"^{paths[1]}: No space left"):
        closed.close()
