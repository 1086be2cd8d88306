"""The recorder joins a running graph, loses nothing on its lossless edges, and leaves it whole."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap")

from operators.record import Record
from pipeline import RunError, SettingsError
from pipeline.client import recording
from pipeline.client.find import find
from pipeline.client.local import LocalGraph
from pipeline.recording.reader import Recording
from pipeline.run.supervisor import Supervisor
from pipeline.testing import drive
from tests.pipeline.recording.test_recorder import frame, percept
from tests.sample_graphs import CHAIN, assert_accounts_add_up, beside, go, plan_of


def record(graph: str, path: Path, outputs: tuple[str, ...] = ()) -> recording.Outcome:
    client = find(graph)
    assert isinstance(client, LocalGraph)
    recording.begin(client, path, recording.chosen(client, outputs), {})
    return recording.follow(client, 1.0, lambda: 0, lambda _accounts: None)


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


def test_a_recorder_without_a_file_is_refused() -> None:
    with pytest.raises(SettingsError, match="expected a file to write, got none"):
        drive(Record, [{"frame_1": frame(0)}], {})
