"""One large ROI against several small ones: frames and truth in, shares and differences out."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.rois import ARRANGEMENTS, GRAPH, IOU, Clip, changes, difference, main, rows, watched
from drivers.sensor import FURTHER
from pipeline.graph.loader import load
from pipeline.messages import Frame, Percept, Truth
from pipeline.testing import header


def heard(clip: Clip, seq: int, windows: list[tuple[int, int, int, int]]) -> None:
    """Pass one exposure to a clip: a ball, a goalkeeper, and a player that cannot be seen."""
    for name, window in zip(("roi", *FURTHER), windows, strict=False):
        shape = (window[3] - window[1], window[2] - window[0], 3)
        pixels = np.zeros(shape, np.uint8)
        clip.hear(f"capture.{name}", Frame(header=header(seq), pixels=pixels, window=window))
    boxes = np.array([[0, 0, 10, 10], [20, 0, 40, 10], [0, 0, 4, 4]], np.float32)
    truth = Truth(
        header=header(seq),
        boxes=boxes,
        ids=np.arange(3, dtype=np.int32),
        labels=("ball", "goalkeeper", "player"),
        visibility=np.array([1, 1, 0], np.float32),
    )
    clip.hear("capture.truth", truth)


def test_shares_are_those_of_the_union_of_the_windows_that_were_read() -> None:
    clip = Clip(skip=1)
    heard(clip, 0, [(0, 0, 10, 10)])
    heard(clip, 1, [(5, 0, 15, 10), (20, 0, 30, 10), (25, 0, 35, 10), (0, 0, 0, 0)])

    assert clip.means() == {"ball": 0.5, "player": 0.75, IOU: 0.0}
    assert clip.read_px == 4 * 100


def test_the_tracker_is_compared_with_the_ball_where_it_is_visible() -> None:
    clip = Clip(skip=0)
    for seq in (0, 1):
        heard(clip, seq, [(0, 0, 10, 10)])
    box = np.array([[0, 0, 10, 5]], np.float32)
    clip.hear(
        "tracker.out",
        Percept(
            header=header(1), boxes=box, ids=np.zeros(1, np.int32), scores=np.ones(1, np.float32)
        ),
    )

    assert clip.means()[IOU] == 0.25  # nothing in one frame, half of the ball in the other


def test_differences_are_paired_by_clip_against_one_window() -> None:
    found = {name: [Clip(skip=0), Clip(skip=0)] for name in ARRANGEMENTS}
    for name, clips in found.items():
        for clip, right in zip(clips, (5, 9) if name == "one" else (6, 10), strict=True):
            heard(clip, 0, [(0, 0, right, 10)])

    told = {(row["windows"], row["class"]): row for row in rows(found)}

    assert told["one", "ball"]["share in a ROI, or IoU"] == 0.7
    assert told["one", "ball"]["against one"] == ""
    assert told["four", "ball"]["against one"] == "+0.100 (+0.100 .. +0.100)"
    assert ("one", "referee") not in told  # there is none


def test_an_interval_of_few_clips_is_wide() -> None:
    few, many = (difference(np.array([0.1, 0.3] * n)) for n in (1, 20))

    assert few.startswith("+0.200 (-1.071")
    assert many.startswith("+0.200 (+0.168")


@pytest.mark.parametrize("name", ARRANGEMENTS)
def test_every_arrangement_may_read_as_many_pixels(name: str) -> None:
    given = dict(change.split("=") for change in changes(name, 70_000, 0.05))

    pixels = int(given["capture.rois"]) * float(given["capture.roi_area"])
    assert pixels == 1 / 16
    assert given["dispatch.windows"] == given["capture.rois"]


def test_the_graph_reads_four_windows_within_its_budget() -> None:
    assert {edge.output for edge in load(GRAPH).edges} >= {"roi", *FURTHER}

    clip = watched(changes("four", 69_000, 0.05), frames=5, skip=3)

    one = 240 * 135
    assert clip.frames == 5
    assert 4 * one < clip.read_px <= 5 * 4 * one
    assert 0 < clip.means()["player"] <= 1


def test_more_frames_to_skip_than_there_are_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "rois.json"

    answer = CliRunner().invoke(main, ["--frames", "5", "--skip", "5", "--json", str(path)])

    assert answer.exit_code == 1
    assert "--skip: expected fewer than the 5 frames, got 5" in answer.output
    assert not path.exists()


def test_the_committed_figures_name_what_was_run() -> None:
    report = json.loads((Path(GRAPH).parents[1] / "bench/results/rois.json").read_text())

    assert report["bench"] == "rois"
    assert report["seed"] >= 70_000
    assert {row["windows"] for row in report["rows"]} == set(ARRANGEMENTS)
    assert max(report["roi_pixels_read"].values()) <= 1.01 * report["roi_pixels_read"]["one"]
