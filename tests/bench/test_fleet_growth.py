"""The growth of a deployment is measured on real agents, over TLS."""

from pathlib import Path

import pytest

from bench.fleet_growth import graph_text, measured
from pipeline.fleet.placement import partners
from pipeline.graph.loader import load


def test_every_host_exposes_and_has_the_first_one_as_its_only_partner(tmp_path: Path) -> None:
    path = tmp_path / "graph.yaml"
    path.write_text(graph_text("star", 50, 2.0))

    found = partners(load(path))

    assert len(found.pop("h0")) == 49
    assert set(found.values()) == {frozenset({"h0"})}


@pytest.mark.lengthy
def test_two_hosts_are_deployed_to_and_measured() -> None:
    pytest.importorskip("cryptography", reason="needs the fleet extra")

    found = measured(2, routed=False, rate=20.0, seconds=1.0)

    assert found["links"] == 2
    assert found["clock_error_most_ms"] > 0
    assert found["packets_per_s"] > 2 * 5  # a ping each way, five times a second, at least
    assert found["other_host_mb"] > 0
    assert all(found[f"{verb}_s"] > 0 for verb in ("up", "ps", "health", "down"))
