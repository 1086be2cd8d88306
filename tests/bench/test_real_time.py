"""Variants of a graph are compared on the same clips, in turns, by what the loop achieved."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from bench.real_time import main, name_of, rotated, rows
from pipeline.errors import RunError

GRAPH = Path("mine.yaml")
FIRST, SECOND = (GRAPH, "saliency.tiles=8"), (GRAPH, "saliency.tiles=2")


def report(*, inside: float, iou: float = 0.5, p50: float = 30.0, visible: int = 100) -> Any:
    """What a run of 200 frames reports, 150 of them planned."""
    return {
        "roi_coverage": {"ball": inside, "mean": 0.4},
        "roi_coverage_frames": {"ball": visible},
        "iou": {"mean": iou, "frames": visible},
        "loop": {"latency_ms": {"p50": p50, "p99": 60.0}, "commands": 150},
        "frames": {"exposed": 200},
    }


def test_shares_are_means_over_the_frames_in_which_the_target_is_visible() -> None:
    clips = {"clip 1": report(inside=0.9, visible=100), "clip 2": report(inside=0.3, visible=50)}

    (row,) = rows({FIRST: clips}, "ball")

    assert row["share in the ROI"] == pytest.approx((90 + 15) / 150)
    assert row["IoU"] == 0.5
    assert row["share in the ROI: above the first"] == ""
    assert row["clips"] == 2


def test_a_variant_stands_above_the_first_by_what_the_same_clips_gained() -> None:
    clips = [f"clip {k}" for k in range(6)]
    first = {clip: report(inside=0.1 * k) for k, clip in enumerate(clips)}
    second = {clip: report(inside=0.1 * k + 0.2, iou=0.4) for k, clip in enumerate(clips)}

    _, row = rows({FIRST: first, SECOND: second}, "ball")

    assert row["variant"] == "mine saliency.tiles=2"
    assert row["share in the ROI: above the first"] == "+0.200 (+0.200 .. +0.200)"
    assert row["IoU: above the first"] == "-0.100 (-0.100 .. -0.100)"


def test_delays_are_told_with_their_spread() -> None:
    clips = {f"clip {k}": report(inside=1, p50=p50) for k, p50 in enumerate((30.0, 28.5, 41.2))}

    (row,) = rows({FIRST: clips}, "ball")

    assert row["loop p50 ms"] == "30 (28.5 .. 41.2)"
    assert row["share of frames planned"] == "0.75 (0.75 .. 0.75)"


def test_each_variant_is_the_first_to_run_in_its_turn() -> None:
    orders = [rotated([FIRST, SECOND], turn) for turn in range(3)]

    assert [order[0] for order in orders] == [FIRST, SECOND, FIRST]
    assert [len(order) for order in orders] == [2, 2, 2]


def test_a_variant_is_named_by_its_graph_and_its_setting() -> None:
    assert name_of((Path("/a/mine.yaml"), "")) == "mine"


def test_a_target_that_the_truth_does_not_have_is_told_with_those_that_it_has() -> None:
    with pytest.raises(RunError, match=r"--target: expected one of ball \(clip 1\), got 'puck"):
        list(rows({FIRST: {"clip 1": report(inside=1)}}, "puck"))


def test_a_graph_that_scores_nothing_is_refused() -> None:
    without = report(inside=1)
    del without["iou"]

    with pytest.raises(RunError, match=r"expected a graph with operators\.score:Score"):
        list(rows({FIRST: {"clip 1": without}}, "ball"))


def test_without_a_graph_nothing_runs() -> None:
    result = CliRunner().invoke(main, [])

    assert result.exit_code == 2
    assert "expected a graph, got none" in result.output


def test_a_graph_of_processes_is_run_with_each_setting(tmp_path: Path) -> None:
    file = tmp_path / "made.json"
    asked = ["tracking", "--each", "policy.patience=12"]

    result = CliRunner().invoke(
        main, [*asked, "--clips", "1", "--frames", "20", "--json", str(file)]
    )

    assert result.exit_code == 0, result.output
    made = json.loads(file.read_text())
    assert [row["variant"] for row in made["rows"]] == [f"tracking {x}" for x in asked[2::2]]
    assert made["rows"][0]["clips"] == 1
