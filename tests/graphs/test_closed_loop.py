"""The loop from light to sensor command and back, in lockstep and in one thread."""

from pathlib import Path
from typing import Any

import pytest

from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.inline import InlineRunner

GRAPH = """
name: loop
clock: lockstep
nodes:
  capture:
    operator: operators.capture:Capture
    inputs: {schedule: dispatch}
    settings: {options: {scene: "tests.drivers.moving_square:MovingSquare", frames: 40}}
  downsample:
    operator: operators.downsample:Downsample
    inputs: {frame: capture.context}
  seer:
    operator: tests.graphs.seer:Seer
    inputs: {frame: downsample}
  dispatch:
    operator: operators.dispatch:Dispatch
    inputs: {scanpath: seer}
"""


def run(tmp_path: Path, *changes: str) -> dict[str, Any]:
    """Run the graph to its end; return its report."""
    path = tmp_path / "loop.yaml"
    path.write_text(GRAPH)
    with InlineRunner(load(path, Overlay(changes=changes))) as runner:
        for _ in runner.run():
            pass
        return dict(runner.report())


def test_the_roi_follows_what_the_context_shows(tmp_path: Path) -> None:
    report = run(tmp_path)

    assert report["windows"] == {"unplanned": 1, "ok": 39}
    assert report["roi_coverage"]["ball"] == pytest.approx(39 / 40)
    assert report["commands"] == {"accepted": 40, "late": 0, "foreign": 0}
    assert report["pixels"] == {"budget": 0.125, "used": 0.125}


def test_prediction_compensates_for_the_latency_of_the_sensor(tmp_path: Path) -> None:
    late = ("capture.latency_frames=6", "capture.roi_area=0.01")

    foreseen = run(tmp_path, *late)["roi_coverage"]["ball"]
    hindsight = run(tmp_path, *late, "seer.foresees=false")["roi_coverage"]["ball"]

    assert foreseen == pytest.approx(33 / 40)
    assert hindsight < foreseen


def test_a_latency_beyond_the_horizon_makes_every_command_late(tmp_path: Path) -> None:
    report = run(tmp_path, "capture.latency_frames=8")

    assert report["commands"] == {"accepted": 0, "late": 40, "foreign": 0}
    assert report["windows"]["stale"] == 39
    assert report["roi_coverage"]["ball"] < 0.5


def test_replanning_within_the_horizon_leaves_no_frame_without_a_plan(tmp_path: Path) -> None:
    report = run(tmp_path, "dispatch.replan_every=8")

    assert report["commands"]["accepted"] == 5
    assert report["windows"] == {"unplanned": 1, "ok": 39}


def test_the_same_seed_gives_the_same_commands(tmp_path: Path) -> None:
    noisy = ("capture.noise=4.0", "capture.seed=3")

    first, second = run(tmp_path, *noisy), run(tmp_path, *noisy)
    other = run(tmp_path, "capture.noise=4.0", "capture.seed=4", "capture.latency_frames=1")

    assert first["schedule_sha256"] == second["schedule_sha256"]
    assert first["roi_coverage"] == second["roi_coverage"]
    assert first["roi_coverage"] != other["roi_coverage"]
