"""What is counted in the files of a recording is what they hold, also of a killed recorder."""

from pathlib import Path

import pytest

pytest.importorskip("mcap")

from pipeline.recording.reader import Recording
from pipeline.recording.recorder import Limits, Recorder
from pipeline.recording.written import counted
from tests.pipeline.recording.test_recorder import frame


def recorded(path: Path, count: int, *, dropped: int = 0, file_bytes: int = 8000) -> list[str]:
    """Record so many frames to files of a few; return the files."""
    recorder = Recorder(path, Limits(chunk_bytes=2000, file_bytes=file_bytes))
    for seq in range(count):
        recorder.add("capture.context", frame(seq), wait=True)
    recorder.accounts["capture.context"].dropped = dropped
    recorder.close()
    return [str(file) for file in recorder.files]


def held(files: list[str]) -> int:
    return sum(len(Recording(Path(f)).messages.get("capture.context", {})) for f in files)


def test_recorders_that_followed_one_another_are_counted_together(tmp_path: Path) -> None:
    files = [file for count in (30, 20) for file in recorded(tmp_path / "a.mcap", count, dropped=2)]

    found = counted(files, (), {})

    assert len(files) > 4
    assert found.outputs["capture.context"] == {
        "recorded": 50, "dropped": 4, "passed": 0, "gaps": 0, "refused": 0,
    }  # fmt: skip
    assert found.faults == {}


def test_a_killed_recorder_is_counted_by_its_whole_chunks_and_its_gap_is_told(
    tmp_path: Path,
) -> None:
    (killed,) = recorded(tmp_path / "a.mcap", 30, file_bytes=0)
    cut = Path(killed)
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    lasted_ns = max(Recording(cut).exposures.values())
    later = recorded(tmp_path / "a.mcap", 20, dropped=3)
    after = Path(later[0])
    gap_s = (min(Recording(after).exposures.values()) - lasted_ns) / 1e9

    found = counted([killed, *later], (), {})

    counts = found.outputs["capture.context"]
    assert 20 < counts["recorded"] == held([killed, *later]) < 50
    assert counts["dropped"] == 3
    assert found.faults == {
        killed: f"{killed}: not written to its end; its whole chunks can be read; then the "
        f"recorder was restarted: {gap_s:.1f} s before {after.name} are missing"
    }


def test_a_file_that_was_not_even_begun_holds_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")

    found = counted([str(tmp_path / "a.mcap")], (), {})

    assert found.outputs == {}
    assert list(found.faults) == [str(tmp_path / "a.mcap")]


def test_what_a_ring_passed_after_its_file_was_written_is_counted(tmp_path: Path) -> None:
    (file,) = recorded(tmp_path / "a.mcap", 2)
    told = {"capture.context": {"recorded": 2, "passed": 40}}

    found = counted([file], [file], told)

    assert found.outputs["capture.context"] == {"recorded": 2, "passed": 40}
    assert counted([], [], told).outputs == told
    assert counted([file], ["other.mcap"], told).outputs["capture.context"]["passed"] == 0
