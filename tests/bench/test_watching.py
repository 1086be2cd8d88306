"""Figures of watching are relative to the run without a viewer of the same round."""

from bench.watching import summarise, table


def test_a_ratio_is_taken_within_a_round() -> None:
    rounds = [
        {"off": {"p50_ms": 10.0, "dropped": 0.0}, "saving": {"p50_ms": 20.0, "dropped": 1.0}},
        {"off": {"p50_ms": 40.0, "dropped": 0.0}, "saving": {"p50_ms": 40.0, "dropped": 3.0}},
    ]

    found = summarise(rounds)

    assert found["saving"]["p50_ms_ratio"] == {"median": 1.5, "min": 1.0, "max": 2.0}
    assert "dropped_ratio" not in found["saving"]  # nothing was dropped without a viewer
    assert "p50_ms_ratio" not in found["off"]
    assert table(found).row_count == 4
