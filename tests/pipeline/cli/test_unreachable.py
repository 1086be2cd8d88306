"""`ps` lists what cannot be reached beside what runs, and `down --forget` takes it off the list."""

import json
import secrets
from pathlib import Path

import pytest

from pipeline.fleet.hosts import Hosts
from pipeline.fleet.remembered import forget, remember, remembered
from tests.pipeline.cli.test_detached import fovea
from tests.sample_graphs import CHAIN, together

NODES = {"capture": "eye", "policy": "brain"}


def here(label: str) -> str:
    """Return an end point at which nobody listens."""
    return f"unixsock-stream//tmp/fovea-nobody-{secrets.token_hex(3)}-{label}.sock"


@pytest.mark.lengthy
def test_what_cannot_be_asked_hides_nothing_that_runs(tmp_path: Path) -> None:
    hosts = {label: here(label) for label in NODES.values()}
    remember("silent", Hosts(hosts, "", NODES))
    remember("locked", Hosts(hosts, str(tmp_path / "no credentials"), NODES))
    name = f"near-{secrets.token_hex(3)}"
    (tmp_path / "graph.yaml").write_text(f"name: {name}\n{together(CHAIN, 'ticker', 'glance')}")
    fovea("run", str(tmp_path / "graph.yaml"), "--detach")
    try:
        told, as_json = fovea("ps"), fovea("ps", "--json")
    finally:
        fovea("stop", name)
        forget("silent")
        forget("locked")

    listed = json.loads(as_json.stdout)
    assert told.returncode == 0, told.stderr
    assert "silent: eye: no agent answers" in told.stdout
    assert "locked: " in told.stdout
    assert "`fovea down locked --forget` takes it off this list" in told.stdout
    assert all(listed[graph]["nodes"] == NODES for graph in ("silent", "locked"))
    assert listed[name]["nodes"].keys() == {"ticker", "count", "glance"}


def test_a_graph_whose_hosts_are_gone_for_good_is_forgotten() -> None:
    remember("away", Hosts({"eye": here("eye")}, "", {"capture": "eye"}))

    wrong = fovea("down", "awya", "--forget")
    right = fovea("down", "away", "--forget", "--json")

    assert "did you mean 'away'" in wrong.stderr
    assert json.loads(right.stdout) == {"graph": "away", "hosts": ["eye"]}
    assert "away" not in remembered()
