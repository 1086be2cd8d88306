"""Faults chosen by a seed: the graph recovers, accounts add up, nothing is left behind."""

import json
import secrets
from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.chaos import main
from bench.grounds import OneHost, ThreeHosts
from bench.netns import permitted
from tests.pipeline.fleet.agents import TRIO
from tests.sample_graphs import LOOP


@pytest.mark.slow
def test_a_graph_recovers_from_every_kind_of_fault(tmp_path: Path) -> None:
    graph, figures = tmp_path / "graph.yaml", tmp_path / "chaos.json"
    graph.write_text(f"name: chaos-{secrets.token_hex(3)}\n{LOOP}")

    words = [str(graph), "--minutes", "0.5", "--seed", "3", "--json", str(figures)]
    done = CliRunner().invoke(main, words)

    assert done.exit_code == 0, done.output
    found = json.loads(figures.read_text())
    assert len(found["faults"]) >= 2
    assert set(found["recovery"]) == set(OneHost.kinds)
    assert (found["unbalanced"], found["orphans"], found["left"]) == ([], [], [])
    assert all(f["restarts"] for f in found["faults"] if f["kind"] != "nap")


@pytest.mark.slow
@pytest.mark.skipif(not permitted(), reason="network namespaces are not permitted here")
def test_a_graph_over_hosts_recovers_from_partitions_too(tmp_path: Path) -> None:
    graph, figures = tmp_path / "graph.yaml", tmp_path / "chaos.json"
    graph.write_text(TRIO)

    words = [str(graph), "--minutes", "1", "--seed", "2", "--json", str(figures)]
    done = CliRunner().invoke(main, words)

    assert done.exit_code == 0, done.output
    found = json.loads(figures.read_text())
    assert set(found["recovery"]) == set(ThreeHosts.kinds)
    assert found["recovery"]["partition"]["count"] >= 1
    assert (found["unbalanced"], found["orphans"], found["left"]) == ([], [], [])
