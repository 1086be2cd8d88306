"""A crowd has the number of objects asked for; its cost is measured in frames with all of them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from bench.crowd import Crowd, CrowdSettings, with_crowd
from bench.objects import counted, main, summarise
from pipeline import Frame, Tracks
from pipeline.boxes import covered
from pipeline.graph.loader import load
from pipeline.testing import drive, header

GRAPH = Path(__file__).parents[2] / "graphs" / "learned.yaml"
WINDOW = (480, 270, 960, 540)


def tracks(*lefts: float) -> Tracks:
    """Return objects of 60x120 pixels, observed in four frames and predicted for two."""
    box = np.array([[left, 300, left + 60, 420] for left in lefts], np.float32)
    box = box.reshape(-1, 4)  # also without objects
    n = len(lefts)
    return Tracks(
        header=header(7),
        ids=np.arange(n, dtype=np.int32),
        labels=np.zeros(n, np.int32),
        scores=np.ones(n, np.float32),
        boxes=np.repeat(box[:, None], 4, 1),
        visible=np.ones((n, 4), np.bool_),
        features=np.zeros((n, 4, 8), np.float32),
        predicted=np.repeat(box[:, None], 2, 1) + 1,
    )


def crowd(given: Tracks, **settings: Any) -> Tracks:
    roi = Frame(header=given.header, pixels=np.zeros((270, 480, 3), np.uint8), window=WINDOW)
    (found,) = drive(Crowd, [{"tracks": given, "roi": roi}], settings)
    assert isinstance(found, Tracks)
    return found


@pytest.mark.parametrize("count", [1, 2, 3, 25])
@pytest.mark.parametrize("together", [False, True])
def test_a_crowd_has_the_number_asked_for_true_objects_first(count: int, together: bool) -> None:
    given = tracks(500, 700, 1500)

    found = crowd(given, objects=count, together=together)

    assert len(set(found.ids.tolist())) == len(found.ids) == count
    assert found.ids[: min(count, 2)].tolist() == [0, 1][:count]
    assert np.array_equal(found.boxes[: min(count, 2)], given.boxes[: min(count, 2)])
    inside = covered(found.boxes[:, -1], np.array(WINDOW, np.float32)) > 0.99
    assert inside.all() if together else inside.sum() == sum(i % 3 < 2 for i in range(count))
    assert (np.abs(found.predicted - found.boxes[:, -1:] - 1) < 0.01).all()


def test_a_crowd_without_true_objects_is_empty() -> None:
    assert not len(crowd(tracks()).ids)


def test_every_reader_of_the_tracks_reads_the_crowd() -> None:
    plan = with_crowd(load(GRAPH), CrowdSettings(objects=5, together=True))

    assert {e.end for e in plan.readers("crowd", "out")} == {"policy.tracks", "roi_features.tracks"}
    assert [e.end for e in plan.readers("association", "out")] == ["crowd.tracks"]
    assert plan.node("crowd").settings == {"objects": 5, "together": True}
    assert "crowd" in plan.command_path()
    assert "witness" not in plan.command_path()


def test_only_frames_with_the_whole_crowd_count() -> None:
    spans = {"frames": [1, 2, 3], "objects": [0, 9, 9], "handler_ns": [0, 8_000_000, 6_000_000]}
    both = {"encoder": spans, "policy": {**spans, "objects": [0, 25, 25]}}
    loop = {name: {"p50": 20.0, "p99": 30.0} for name in ("latency_ms", "overhead_ms")}
    one = {"objects": 25, "witness": both, "noting_ms": {"p50": 0.25, "p99": 0.5}, "loop": loop,
           "duration_s": 10.0, "stages": [{"node": "policy", "cpu_percent": 5.0}],
           "edges": [{"offered": 250, "dropped": {"superseded": 2}}]}  # fmt: skip

    found = summarise([one])

    assert (found["frames"], found["encoded"], found["drops"]) == (2, 9, 2)
    assert found["encoder_ms"]["p50"] == found["policy_ms"]["p50"] == 7.0
    assert found["together_ms"]["p50"] == 14.25
    assert found["processor_ms"] == 2.0
    assert found["loop"]["latency_ms_p50"]["median"] == 20.0


def test_handler_times_less_those_of_plans_are_those_of_features() -> None:
    called = counted([300_000, 2_000_000, 310_000, 2_100_000])

    left = called.since(counted([2_000_000, 2_100_000]).counts)

    assert left.total == 2
    assert left.summary()["p99"] == pytest.approx(0.31, rel=0.02)


def test_a_graph_without_tracks_is_refused_in_one_sentence(tmp_path: Path) -> None:
    graph = tmp_path / "graph.yaml"
    graph.write_text("name: x\nnodes:\n  policy:\n    operator: tests.samples:Ticker\n")

    done = CliRunner().invoke(main, [str(graph)])

    assert done.exit_code == 1
    assert done.output.startswith("Error: ")
    assert len(done.output.splitlines()) == 1
