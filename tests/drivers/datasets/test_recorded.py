"""A recording of full-resolution frames is a source for a sensor."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap")

from drivers.datasets import recorded
from drivers.datasets.recorded import RecordedFrames
from pipeline.errors import DriverError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.shipped import source_path
from pipeline.recording.mcap_file import McapChunks
from pipeline.recording.recorder import Limits, Recorder
from pipeline.run.inline import InlineRunner
from pipeline.run.replay import record_inline
from tests.sample_graphs import plan_of

FULL = """\
nodes:
  capture:
    operator: operators.capture:Capture
    settings:
      options: {scene: soccer, size_px: [320, 192], rate_hz: 30, seed: 7, strategy: STRATEGY}
"""


def record(tmp_path: Path, strategy: str) -> Path:
    plan = plan_of(tmp_path, FULL.replace("STRATEGY", strategy), clock="lockstep")
    record_inline(plan, tmp_path / "a.mcap", 4, lambda: 0)
    return tmp_path / "a.mcap"


def test_another_sensor_runs_on_the_recorded_light(tmp_path: Path) -> None:
    path = record(tmp_path, "full")
    source = RecordedFrames(path=str(path))
    overlay = Overlay(source=source_path("recording"), clock="lockstep",
                      values=(("capture", "path", str(path)),))  # fmt: skip
    seen = {}

    plan = load(tmp_path / "graph.yaml", overlay)
    with InlineRunner(plan, watch=lambda o, m: seen.setdefault((o, m.header.seq), m)) as runner:
        frames = list(runner.run())

    assert (frames, source.size_px, source.length) == ([0, 1, 2, 3], (320, 192), 4)
    left, top, right, bottom = seen["capture.roi", 2].window
    cut = source.picture(2)[top:bottom, left:right]
    assert np.array_equal(seen["capture.roi", 2].pixels, cut)
    assert len(seen["capture.truth", 2].boxes)


def test_frames_of_less_than_full_resolution_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="at full resolution, 320x192, got"):
        RecordedFrames(path=str(record(tmp_path, "foveated")))


def test_a_recording_without_that_output_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match=r"expected frames of capture\.big, got those of capture"):
        RecordedFrames(path=str(record(tmp_path, "full")), output="capture.big")


def damaged(path: Path, at: int) -> Path:
    """Change 50 bytes of a file."""
    data = bytearray(path.read_bytes())
    data[at : at + 50] = (byte ^ 0xFF for byte in data[at : at + 50])
    path.write_bytes(data)
    return path


def places(path: Path) -> list[int]:
    """Return where the chunks of a file are."""
    return [place for place, _items in McapChunks(path).scan()]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a recording of four frames with a chunk for each item, the first one a fact."""
    plan = plan_of(tmp_path, FULL.replace("STRATEGY", "full"), clock="lockstep")
    recorder = Recorder(tmp_path / "b.mcap", Limits(chunk_bytes=1))
    recorder.note("graph", {})
    with InlineRunner(plan, watch=lambda o, m: recorder.add(o, m, wait=True)) as runner:
        list(runner.run(4))
    recorder.close()
    return tmp_path / "b.mcap"


@pytest.mark.parametrize("whole", [True, False])
def test_frames_that_damage_keeps_from_a_source_are_told(
    whole: bool, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    count = len(places(path)) // 2
    at = places(path)[count]
    if not whole:
        damaged(path, at + 60)

    source = RecordedFrames(path=str(path))

    assert (source.length == 4) == whole
    assert [r.getMessage() for r in caplog.records if r.name == recorded.__name__] == [
        f"{path}: is damaged at byte {at} of {path.stat().st_size}, and not read from there on, "
        f"after {count} whole chunks; it has {source.length} frames"
    ] * (not whole)


@pytest.mark.parametrize("damage", ["cut", "changed"])
def test_a_recording_that_is_broken_before_its_first_picture_is_refused_with_the_reason(
    damage: str, path: Path
) -> None:
    at = places(path)[1]
    if damage == "cut":
        path.write_bytes(path.read_bytes()[: at + 50])
    else:
        damaged(path, at + 60)
    why = {"cut": "it ends early, after 1 whole chunk", "changed": f"it is damaged at byte {at} of"}

    with pytest.raises(DriverError, match=f"of capture.context, got no messages; {why[damage]}"):
        RecordedFrames(path=str(path))
