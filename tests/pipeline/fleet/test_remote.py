"""Commands on a deployed graph: the health of its nodes, files sent with a setting, `down`."""

import hashlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from pipeline.client.find import find
from pipeline.errors import FoveaError, GraphError, RunError, Silent
from pipeline.fleet.agent_file import AgentFile, HostConfig
from pipeline.fleet.deploy import Fleet, down, send_weights, up
from pipeline.fleet.hosts import Hosts
from pipeline.fleet.placement import ANY, MOST_WEIGHTS_BYTES
from pipeline.fleet.remembered import forget, remember, remembered
from pipeline.protocol import fleet as wire
from tests.pipeline.fleet.agents import Running, fleet_of, plan_of

ALLOWED = {"tests.samples:Ticker": ANY, "tests.samples:Model": ANY}
OLD, NEW = b"an old model", b"a newer model"
PAIR = """
name: remote
hosts: [eye, brain]
nodes:
  capture:
    operator: tests.samples:Ticker
    host: eye
  look:
    operator: tests.samples:Model
    host: brain
    inputs: {frame: capture.context}
"""


@pytest.fixture
def two(tmp_path: Path) -> Iterator[dict[str, Running]]:
    known = {hashlib.sha256(data).hexdigest(): "" for data in (OLD, NEW)}
    running = {}
    try:
        for label, other in (("eye", "brain"), ("brain", "eye")):
            file = AgentFile(label=label, hosts=(other,), operators=ALLOWED, weights=known)
            running[label] = Running(HostConfig(file, tmp_path))
        yield running
    finally:
        for one in running.values():
            one.stop()


@pytest.fixture
def fleet(two: dict[str, Running], tmp_path: Path) -> Iterator[Fleet]:
    with fleet_of("eye", "brain") as fleet:
        up(fleet, plan_of(tmp_path, PAIR))
        yield fleet
        down("remote", fleet.hosts)


def test_graphs_that_are_brought_up_at_once_are_all_remembered() -> None:
    names = [f"one-of-many-{i}" for i in range(12)]
    with ThreadPoolExecutor(len(names)) as pool:
        list(pool.map(lambda name: remember(name, Hosts({"eye": "here"})), names))

    assert set(names) <= remembered().keys()

    with ThreadPoolExecutor(len(names)) as pool:
        list(pool.map(forget, names))
    assert not set(names) & remembered().keys()


def test_a_file_for_a_live_setting_goes_along_and_any_other_is_refused(
    fleet: Fleet, tmp_path: Path
) -> None:
    old, new, foreign = (tmp_path / name for name in ("old.onnx", "new.onnx", "foreign.onnx"))
    old.write_bytes(OLD)
    new.write_bytes(NEW)
    foreign.write_bytes(b"of somebody")

    there = find("remote").configure("look", {"weights": str(new)}).settings["weights"]

    assert Path(there).read_bytes() == NEW
    assert Path(there) != new
    with pytest.raises(RunError, match=r"look\.spare: cannot change .* `fovea swap remote look"):
        find("remote").configure("look", {"spare": str(old)})
    lacking = wire.Lacks((hashlib.sha256(OLD).hexdigest(),))
    assert fleet.ask("brain", "lacks", lacking, wire.Missing).digests  # it was not sent
    refused = r"look\.weights: weights .* are not on the allow list"
    with pytest.raises(FoveaError, match=refused):
        find("remote").configure("look", {"weights": str(foreign)})


def test_the_health_of_a_deployed_graph_is_that_of_its_nodes_on_all_hosts(
    two: dict[str, Running], fleet: Fleet
) -> None:
    found = find("remote").health()

    look = found["look"]
    assert look is not None
    assert (look.host, look.problem) == ("brain", "")
    two["brain"].stop()
    found = find("remote").health()
    assert found["capture"] is not None
    assert found["look"] is None
    with pytest.raises(RunError, match="no log of a node look; brain: no agent answers"):
        list(find("remote").logs("look", 9))
    two["brain"] = Running(two["brain"].agent.host)


def test_a_graph_is_down_when_no_host_has_it_any_more(fleet: Fleet) -> None:
    fleet.ask("brain", "down", wire.Named("remote"), wire.Accepted)

    assert down("remote", fleet.hosts) == []
    assert "remote" not in remembered()


def test_weights_that_no_message_can_carry_are_not_sent(tmp_path: Path) -> None:
    large = tmp_path / "large.onnx"
    with large.open("wb") as file:
        file.truncate(MOST_WEIGHTS_BYTES + 1)

    with fleet_of("nowhere") as fleet, pytest.raises(GraphError, match="expected up to 255 MiB"):
        send_weights(fleet, "nowhere", ["digest"], {"digest": large})


def test_an_agent_that_does_not_answer_is_reported_as_silent() -> None:
    with fleet_of("nowhere") as fleet, pytest.raises(Silent, match="no agent answers"):
        fleet.ask("nowhere", "about", wire.Nothing(), wire.About, 0.2)
