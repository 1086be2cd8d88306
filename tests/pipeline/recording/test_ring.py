"""A ring keeps the newest messages, writes them when asked, and counts what became of each."""

import errno
from pathlib import Path

import pytest

pytest.importorskip("mcap")

from pipeline.recording.mcap_file import Item, McapWriter
from pipeline.recording.reader import Recording
from pipeline.recording.recorder import Limits, Recorder
from tests.pipeline.recording.test_recorder import frame, seqs


def test_a_ring_writes_its_last_messages_on_an_event_only(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", Limits(ring_s=60, ring_bytes=10_000))
    for seq in range(40):
        recorder.add("capture.context", frame(seq), wait=True)
    assert recorder.files == []

    recorder.dump("the target was lost")
    recorder.close()

    found = seqs(tmp_path / "a.mcap")
    assert 0 < len(found) < 40
    assert found == list(range(40))[-len(found) :]
    assert Recording(tmp_path / "a.mcap").newest("events") == {"event": "the target was lost"}


def test_a_ring_counts_what_it_wrote_and_what_passed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", Limits(ring_s=60, ring_bytes=10_000))
    for seq in range(40):
        recorder.add("capture.context", frame(seq), wait=True)
    recorder.dump("asked for")
    for seq in range(40, 43):
        recorder.add("capture.context", frame(seq), wait=True)
    recorder.close()

    written = len(seqs(tmp_path / "a.mcap"))
    counts = recorder.figures()["capture.context"]
    assert (counts["recorded"], counts["passed"], counts["dropped"]) == (written, 43 - written, 0)
    end = Recording(tmp_path / "a.mcap").newest("end")["accounts"]["capture.context"]
    assert (end["recorded"], end["passed"]) == (written, 40 - written)


def test_what_a_ring_holds_when_the_disk_is_full_is_dropped(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def full(self: McapWriter, item: Item) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    recorder = Recorder(tmp_path / "a.mcap", Limits(ring_s=60))
    for seq in range(10):
        recorder.add("capture.context", frame(seq), wait=True)
    monkeypatch.setattr(McapWriter, "add", full)
    recorder.dump("asked for")

    assert "No space left on device" in recorder.close()
    counts = recorder.figures()["capture.context"]
    assert (counts["recorded"], counts["passed"], counts["dropped"]) == (0, 0, 10)


def test_a_ring_writes_each_event_once(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", Limits(ring_s=30.0))
    recorder.note("events", {"event": "added", "node": "glance"})
    recorder.add("capture.context", frame(0), wait=True)
    recorder.dump("asked for")
    recorder.close()

    events = Recording(tmp_path / "a.mcap").facts["events"]

    assert sorted(event["event"] for event in events) == ["added", "asked for"]
