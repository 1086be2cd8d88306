"""Run times of the parts are measured on the shipped graph, by the number of objects."""

import time
from pathlib import Path

import pytest

from bench.run_time import (
    COUNTS,
    TOTAL,
    by_objects,
    by_objects_markdown,
    markdown,
    networks_of,
    run_time,
)
from bench.tracking.options import GRAPH
from bench.tracking.stages import Stages


def test_every_part_is_timed_with_all_objects_described() -> None:
    table = run_time((), frames=4, policy="pursuit")

    assert table["objects"]["p50"] > 5
    total = table[TOTAL]
    assert total["p50"] >= max(table["saliency"]["p50"], table["association"]["p50"])
    assert f"| {TOTAL} | {total['p50']} | {total['p99']} | 64.7 |" in markdown(table)
    for name in ("downsample", "saliency", "association", "policy", "roi_features", "tracker"):
        assert 0 < table[name]["p50"] <= table[name]["p99"]
    assert f"| saliency | {table['saliency']['p50']} |" in markdown(table)


def test_the_networks_that_are_timed_alone_are_those_of_the_graph(tmp_path: Path) -> None:
    own = tmp_path / "policy.onnx"

    shipped, given, none = (
        networks_of(Stages(GRAPH, changes, policy=policy))
        for changes, policy in (((), ""), ((f"policy.weights={own}",), ""), ((), "pursuit"))
    )

    assert [file.name for file in shipped] == ["roi_encoder.onnx", "policy.onnx"]
    assert given == [shipped[0], own]
    assert none == shipped[:1]


def test_more_objects_take_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.perf_counter_ns", time.thread_time_ns)  # without other load

    table = by_objects((), frames=4)

    assert list(table) == [str(count) for count in COUNTS]
    assert table["25"]["p50"] > table["1"]["p50"] > 0
    assert table["25"]["networks"] > table["1"]["networks"] > 0
    assert f"| 25 | {table['25']['p50']} |" in by_objects_markdown(table)
