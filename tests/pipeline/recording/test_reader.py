"""Files that are read as recordings, and what of them is kept in memory."""

import errno
import os
from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import pytest

pytest.importorskip("mcap")

from pipeline.errors import MessageError, RunError
from pipeline.messages import Tracks
from pipeline.recording.mcap_file import McapWriter
from pipeline.recording.reader import Recording, end_of
from pipeline.recording.recorder import Limits, Recorder
from pipeline.recording.records import fact
from pipeline.version import described
from tests.pipeline.recording.test_recorder import frame


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


def test_each_file_ends_with_the_counts_of_what_it_and_those_before_it_hold(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", Limits(chunk_bytes=2000, file_bytes=8000))
    for seq in range(60):
        recorder.add("capture.context", frame(seq), wait=True)
    recorder.close()

    held = [len(Recording(file).messages["capture.context"]) for file in recorder.files]
    ends = [end_of(file) for file in recorder.files]
    counted = [end.accounts["capture.context"]["recorded"] for end in ends if end]
    assert len(held) > 3
    assert [end.file for end in ends if end] == list(range(1, len(held) + 1))
    assert counted == list(accumulate(held))


def test_what_was_to_begin_a_file_is_dropped_where_the_disk_is_full(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def full(_writer: McapWriter) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(McapWriter, "close", full)
    recorder = Recorder(tmp_path / "a.mcap", Limits(chunk_bytes=2000, file_bytes=8000))
    for seq in range(60):
        recorder.add("capture.context", frame(seq), wait=True)

    assert "No space left on device" in recorder.close()
    figures = recorder.figures()["capture.context"]
    assert figures["recorded"] + figures["dropped"] == 60


@pytest.mark.parametrize("data", [b"[" * 100_000, b'{"a": "\xff"}', b"", b"3"])
def test_a_fact_that_cannot_be_read_is_passed_over(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, chunk_bytes=2000, chunk_s=1)
    whole = fact("graph", {"version": "0.0.1"}, at_ns=1)
    for item in (replace(whole, data=data), whole):
        writer.add(item)
    writer.close()

    assert Recording(path).facts == {"graph": [{"version": "0.0.1"}]}


def test_a_message_of_another_version_is_refused_with_both_versions(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap")
    recorder.note("graph", {"version": "0.0.1"})
    recorder.add("capture.context", frame(0), wait=True)
    recorder.close()

    with pytest.raises(MessageError) as refused:  # `Tracks` has another schema than `Frame`
        Recording(tmp_path / "a.mcap").message("capture.context", Tracks, ("test", 0))

    assert str(refused.value) == (
        f"{tmp_path / 'a.mcap'}: capture.context: frame 0: recorded with another schema of Tracks; "
        f"recorded by fovea 0.0.1, read by {described()}"
    )
