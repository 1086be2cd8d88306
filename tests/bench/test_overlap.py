"""IoU and ROI share of a running graph, minute by minute."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from bench import follow
from bench.overlap import (
    Sums,
    Watcher,
    WatcherSettings,
    counted,
    ends,
    mean,
    read,
    watched,
    written,
)
from bench.soak import faded
from pipeline import Frame, Percept, Truth
from pipeline.errors import RunError
from pipeline.graph.loader import load
from pipeline.run.node_reports import MOST_HEADLINE
from pipeline.testing import header
from tests.sample_graphs import LOOP

ROOT = Path(__file__).resolve().parents[2]
BALL, FIRST, SECOND = (100, 100, 120, 120), (300, 100, 340, 200), (900, 100, 940, 200)
ROI = (0, 0, 480, 270)


def seen(*boxes: tuple[int, ...]) -> Percept:
    return Percept(
        header=header(0),
        boxes=np.array(boxes, np.float32).reshape(-1, 4),
        ids=np.arange(len(boxes), dtype=np.int32),
        scores=np.ones(len(boxes), np.float32),
    )


def real(*boxes: tuple[int, ...], labels: tuple[str, ...], visible: float = 1.0) -> Truth:
    return Truth(
        header=header(0),
        boxes=np.array(boxes, np.float32).reshape(-1, 4),
        ids=np.arange(len(boxes), dtype=np.int32),
        labels=labels,
        visibility=np.full(len(boxes), visible, np.float32),
    )


def roi() -> Frame:
    return Frame(header=header(0), pixels=np.zeros((270, 480, 3), np.uint8), window=ROI)


def test_a_frame_without_an_answer_counts_with_iou_0() -> None:
    truth = real(BALL, FIRST, labels=("ball", "main referee"))
    sums = Sums(target="ball")

    for box in (BALL, None):
        sums = counted(sums, seen(*([box] if box else [])), truth, roi())

    assert sums == Sums(target="ball", frames=2, answered=1, iou=1.0, shown=2.0)


def test_any_object_of_the_class_counts() -> None:
    truth = real(FIRST, SECOND, labels=("main referee", "assistant referee"))
    nothing = Sums(target="referee")

    assert counted(nothing, seen(SECOND), truth, roi()).iou == 1.0
    assert counted(nothing, seen(SECOND), truth, roi()).shown == 0.0
    assert counted(nothing, seen(BALL), truth, roi()).shown == 1.0


def test_an_object_that_is_not_visible_does_not_count() -> None:
    truth = real(BALL, labels=("ball",), visible=0.1)

    assert counted(Sums(target="ball"), seen(BALL), truth, roi()).frames == 0
    assert counted(Sums(target="referee"), seen(BALL), truth, roi()).frames == 0


def test_the_watcher_reports_the_last_two_spans_each_with_its_own_target() -> None:
    subject = Watcher(WatcherSettings())
    subject.open()
    for span, target in enumerate(("ball", "referee", "ball")):
        subject.on_settings(WatcherSettings(span=span, target=target))
        subject.on_percept_truth_roi(seen(BALL), real(BALL, labels=("ball",)), roi())

    told = read(subject.headline())

    assert list(told) == [1, 2]
    assert told[1] == Sums(target="referee")
    assert told[2].iou == 1.0


def test_a_report_of_long_spans_fits_into_a_headline() -> None:
    long = Sums(target="x" * 20, frames=10**7, answered=10**7, iou=1e7 / 3, shown=1e7 / 3)

    assert len(written({10**5: long, 10**5 + 1: long})) <= MOST_HEADLINE


def row(span: int, iou: float, target: str = "ball") -> dict[str, Any]:
    figures = {"iou": iou, "shown": 1.0, "answered": 1.0}
    return {"span": span, "target": target, "frames": 10, **figures}


def test_the_first_ten_minutes_are_compared_with_the_last_ten() -> None:
    rows = [row(k, 0.6 if k < 10 else 0.1 if k < 20 else 0.5) for k in range(30)]

    found = ends(rows)["ball"]

    assert (found["first"]["iou"], found["last"]["iou"]) == (0.6, 0.5)
    assert found["grown"]["iou"] == -0.1
    assert faded(rows)[0] == "IoU, first ten minutes -> last ten: 0.600 -> 0.500"
    assert faded([]) == []


def test_spans_are_weighted_by_their_frames() -> None:
    assert mean([row(0, 1.0), {**row(1, 0.0), "frames": 30}])["iou"] == 0.25
    assert mean([]) == {}


def test_a_graph_that_tracks_nothing_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "toy.yaml"
    path.write_text(f"name: toy\n{LOOP}")

    with pytest.raises(RunError, match=r"expected a node .* to watch, got none"):
        watched(load(path))


@pytest.mark.slow
def test_every_change_of_target_is_counted_by_itself_and_written_at_once(tmp_path: Path) -> None:
    out, picture = tmp_path / "follow.json", tmp_path / "follow.png"
    words = ["--minutes", "0.4", "--change-every-s", "8", "--out", str(out)]

    graph = str(ROOT / "graphs" / "tracking.yaml")
    done = CliRunner().invoke(follow.main, [graph, *words, "--plot", str(picture)])

    assert done.exit_code == 0, done.output
    found = json.loads(out.read_text())
    assert [r["target"] for r in found["rows"]] == ["ball", "referee", "ball"]
    assert {"commit", "machine", "seed", "tracker"} <= set(found)
    assert picture.stat().st_size > 1000
