"""A recording of full-resolution frames is a source for a sensor."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap")

from drivers.datasets.recorded import RecordedFrames
from pipeline.errors import DriverError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.shipped import source_path
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
