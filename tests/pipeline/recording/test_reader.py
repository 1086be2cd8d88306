"""Files that are read as recordings, and what of them is kept in memory."""

import os
from pathlib import Path

import pytest

pytest.importorskip("mcap")

from pipeline import RunError
from pipeline.recording.reader import Recording
from pipeline.recording.recorder import Recorder


def test_a_pipe_is_refused_rather_than_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mcap")

    with pytest.raises(RunError, match="cannot be read: expected a file, got a device or a pipe"):
        Recording(tmp_path / "a.mcap")


def test_of_what_is_repeated_every_second_the_newest_is_kept(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    for number in range(3):
        for name in ("accounts", "settings", "events"):
            recorder.note(name, {"number": number})
    recorder.close()

    found = Recording(tmp_path / "a.mcap")

    assert [found.newest(name)["number"] for name in ("accounts", "settings", "events")] == [2] * 3
    assert [len(found.facts[name]) for name in ("accounts", "settings", "events")] == [1, 1, 3]
