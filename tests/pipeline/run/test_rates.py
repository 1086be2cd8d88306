"""The rate in a report is that of the exposures, excluding start and stop."""

import secrets
from pathlib import Path

from pipeline.run.loaded_graph import load
from tests.sample_graphs import CHAIN


def test_the_rate_of_a_run_counts_from_its_first_exposure_however_long_a_node_takes_to_open(
    tmp_path: Path,
) -> None:
    text = CHAIN.replace(
        "tests.samples:Pass\n", "tests.faulty_samples:Sick\n    settings: {open_s: 2}\n"
    )
    graph = tmp_path / "graph.yaml"
    graph.write_text(f"name: test-{secrets.token_hex(3)}\n{text}")

    report = load(graph).run(20, processes=True)

    assert report["duration_s"] >= 19 / 20
    assert report["rate"]["frames"] == 20
    assert report["rate"]["achieved_hz"] <= 20 / (19 / 20)
