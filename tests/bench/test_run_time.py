"""What the parts take is measured on the shipped graph, with as many objects as it says."""

from bench.run_time import COUNTS, by_objects, by_objects_markdown, markdown, run_time


def test_every_part_is_timed_with_all_objects_described() -> None:
    table = run_time(("policy.strategy=pursue", "tracker.method=correlation"), frames=4)

    assert table["objects"]["p50"] > 5
    for name in ("downsample", "saliency", "association", "policy", "roi_features", "tracker"):
        assert 0 < table[name]["p50"] <= table[name]["p99"]
    assert f"| saliency | {table['saliency']['p50']} |" in markdown(table)


def test_more_objects_take_more_time() -> None:
    table = by_objects((), frames=4)

    assert list(table) == [str(count) for count in COUNTS]
    assert table["25"]["p50"] > table["1"]["p50"] > table["1"]["networks"] > 0
    assert f"| 25 | {table['25']['p50']} |" in by_objects_markdown(table)
