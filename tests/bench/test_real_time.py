"""Variants of a graph are compared on the same clips, in turns, by what the loop achieved."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from bench.real_time import check, main, name_of, rotated, rows
from pipeline.errors import RunError

FIRST, SECOND = "mine saliency.tiles=8", "mine saliency.tiles=2"


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
    assert (row["frames scored"], row["clips"]) == (150, 2)


def test_a_variant_stands_above_the_first_by_what_the_same_clips_gained() -> None:
    clips = [f"clip {k}" for k in range(6)]
    first = {clip: report(inside=0.1 * k) for k, clip in enumerate(clips)}
    second = {clip: report(inside=0.1 * k + 0.2, iou=0.4) for k, clip in enumerate(clips)}

    _, row = rows({FIRST: first, SECOND: second}, "ball")

    assert row["variant"] == SECOND
    assert row["share in the ROI: above the first"] == "+0.200 (+0.200 .. +0.200)"
    assert row["IoU: above the first"] == "-0.100 (-0.100 .. -0.100)"


def test_delays_have_their_spread() -> None:
    clips = {f"clip {k}": report(inside=1, p50=p50) for k, p50 in enumerate((30.0, 28.5, 41.2))}

    (row,) = rows({FIRST: clips}, "ball")

    assert row["loop p50 ms"] == "30 (28.5 .. 41.2)"
    assert row["share of frames planned"] == "0.75 (0.75 .. 0.75)"


def test_each_variant_is_the_first_to_run_in_its_turn() -> None:
    variants = [(Path("a.yaml"), ""), (Path("b.yaml"), "")]

    orders = [rotated(variants, turn) for turn in range(3)]

    assert [order[0] for order in orders] == [variants[0], variants[1], variants[0]]
    assert [len(order) for order in orders] == [2, 2, 2]


def test_a_variant_is_named_by_its_graph_and_its_setting_without_the_folder() -> None:
    assert name_of((Path("/a/mine.yaml"), "")) == "mine"
    assert name_of((Path("/a/mine.yaml"), "saliency.weights=/a/b.onnx")).endswith("=b.onnx")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"failure": "saliency died"}, "clip 1: saliency died"),
        ({"frames": {"exposed": 70}}, "clip 1: expected 200 frames, got 70"),
        ({"roi_coverage_frames": {"puck": 3}}, "expected a target of puck, scored, got 'ball'"),
        ({"roi_coverage_frames": {"ball": 0}}, "expected a target of ball, scored, got 'ball'"),
        ({"iou": None}, "expected a target of ball, scored, got 'ball'"),
    ],
)
def test_a_run_that_is_no_measurement_is_refused_at_once(
    change: dict[str, Any], sentence: str
) -> None:
    made = {**report(inside=1), **change}
    made = {name: value for name, value in made.items() if value is not None}

    with pytest.raises(RunError, match=sentence):
        check(made, "ball", 200, "clip 1")


def test_a_whole_run_is_a_measurement() -> None:
    check(report(inside=1), "ball", 200, "clip 1")


def test_variants_of_one_name_are_refused_before_anything_runs() -> None:
    result = CliRunner().invoke(main, ["tracking", "tracking"])

    assert result.exit_code == 1
    assert "expected variants of different names, got tracking twice" in result.output


@pytest.mark.lengthy
def test_graphs_of_processes_run_with_each_setting_in_turns(tmp_path: Path) -> None:
    file = tmp_path / "made.json"
    settings = ["policy.patience=12", "policy.patience=24"]
    asked = ["tracking", "--each", settings[0], "--each", settings[1]]

    result = CliRunner().invoke(
        main, [*asked, "--clips", "1", "--frames", "20", "--json", str(file)]
    )

    assert result.exit_code == 0, result.output
    made = json.loads(file.read_text())
    assert [row["variant"] for row in made["rows"]] == [f"tracking {one}" for one in settings]
    assert made["rows"][0]["clips"] == 1
