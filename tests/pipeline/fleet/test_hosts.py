"""Three hosts with TLS: a graph runs, hosts are lost and come back, intruders fail."""

import json
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bench.hosts import DESK, World
from bench.netns import permitted
from pipeline import RunError
from pipeline.bus.network import LEASE_MS
from pipeline.fleet import secure
from pipeline.fleet.names import user_identity
from tests.pipeline.fleet.agents import TRIO
from tests.sample_graphs import until

pytestmark = [
    pytest.mark.hosts,
    pytest.mark.skipif(not permitted(), reason="network namespaces are not permitted here"),
]
AHEAD_S = 1000


class Watched(World):
    """Hosts whose states come from one `fovea top`: a command for each look takes a second."""

    def watch(self) -> None:
        """Start reading the states of the graph, which is up."""
        words = ("-m", "pipeline.cli", "top", self.plan.name, "--json", "--every-s", "0.1")
        self._top = self.start(DESK, *words)
        self._looks: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._top.stdout is not None
        with self._top.stdout as lines:
            for line in lines:
                if line.startswith("{"):
                    self._looks.append(line)

    def states(self) -> dict[str, Any]:
        """Return what each host now says of the graph, or why it says nothing."""
        seen = len(self._looks)  # the next one may have begun before
        until(lambda: len(self._looks) > seen + 1 or not self._reader.is_alive())
        found: dict[str, Any] = json.loads(self._looks[-1])["hosts"]
        return found


@pytest.fixture(scope="module")
def world() -> Iterator[Watched]:
    folder = Path(tempfile.mkdtemp(prefix="world"))  # a short path: there are sockets below it
    graph = folder / "graph.yaml"
    graph.write_text(TRIO)
    with Watched(folder, graph, compute=AHEAD_S) as world:
        world.up()
        world.watch()
        yield world


def part(world: World, label: str) -> dict[str, Any]:
    found: list[Any] = []

    def answers() -> bool:  # half-open links of the intruders delay an agent
        found[:] = [s for s in world.states()[label] if isinstance(s, dict)]
        return bool(found)

    until(answers)
    assert isinstance(found[0], dict)
    return found[0]


def node(world: World, label: str, name: str) -> dict[str, Any]:
    found = next(n for n in part(world, label)["nodes"] if n["name"] == name)
    assert isinstance(found, dict)
    return found


def edge(world: World, label: str, end: str) -> dict[str, Any]:
    found = next(e for e in part(world, label)["edges"] if e["end"] == end)
    assert isinstance(found, dict)
    return found


def test_the_loop_closes_over_hosts_with_clocks_of_their_own(world: World) -> None:
    until(lambda: edge(world, "sensor", "capture.schedule")["account"]["delivered"] > 5)

    hosts = {b["label"]: b for b in part(world, "sensor")["hosts"]}
    error_ms = hosts["compute"]["clock_error_ms"]
    assert 0 < error_ms < 50
    assert abs(hosts["compute"]["clock_ahead_ms"] - 1000 * AHEAD_S) <= error_ms
    read = edge(world, "compute", "pair.right")
    assert 0 < read["age_ms"]["p50"] < 5000  # not the 1000 s by which the clocks differ
    assert read["age_error_ms"] > 0


def test_ps_shows_every_host_and_logs_come_from_the_host_that_has_them(world: World) -> None:
    shown = world.fovea("ps")

    assert all(label in shown for label in ("sensor", "viewer", "capture", "count"))
    assert "hosts" in world.fovea("top", "trio", "--once")
    assert world.fovea("logs", "trio", "count") is not None
    with pytest.raises(RunError, match=r"no node cuont, did you mean .count."):
        world.fovea("logs", "trio", "cuont")


def test_a_lost_host_is_reported_before_its_links_end_and_its_nodes_come_back(world: World) -> None:
    label, seer = "viewer", "sensor"
    since = len(world.log(seer).read_text())

    world.link(label, up=False)
    try:
        missed_s = world.heard(seer, f"host {label} is lost", since)
        assert missed_s < LEASE_MS / 1000
        assert "no agent answers" in world.states()[label]
        assert node(world, "compute", "work")["condition"] in ("waiting", "busy")
    finally:
        world.link(label, up=True)

    world.heard(seer, f"host {label} is back", since)
    before = node(world, label, "count")["handled"]
    try:
        until(lambda: node(world, label, "count")["handled"] > before + 10)
    except AssertionError as error:  # it failed once: show where the messages are
        logs = {name: world.log(name).read_text()[-1500:] for name in (seer, label)}
        raise AssertionError(f"{error}\n{world.states()}\n{logs}") from error


def test_a_cable_that_is_out_for_long_silences_no_other_host(world: World) -> None:
    label, seer = "viewer", "sensor"
    since = len(world.log(seer).read_text())

    world.link(label, up=False)
    try:
        world.heard(seer, f"host {label} is lost", since)
        time.sleep(LEASE_MS / 1000 + 2)  # the links have ended by now
        earlier = node(world, "compute", "work")["handled"]
        until(lambda: node(world, "compute", "work")["handled"] > earlier + 10)
    finally:
        world.link(label, up=True)
    world.heard(seer, f"host {label} is back", since)
    before = node(world, label, "count")["handled"]
    until(lambda: node(world, label, "count")["handled"] > before + 10)

    assert "compute is lost" not in " ".join(world.log(seer).read_text()[since:].split())


def test_a_host_that_was_switched_off_continues_from_the_accounts_of_the_others(
    world: World,
) -> None:
    before = edge(world, "viewer", "count.frame")["account"]["delivered"]
    agent = world.agents["viewer"]

    agent.send_signal(signal.SIGTERM)
    agent.wait(30)
    world.begin("viewer")

    until(lambda: isinstance(world.states()["viewer"], list))
    until(lambda: part(world, "viewer")["phase"] == "running")
    account = edge(world, "viewer", "count.frame")["account"]
    assert account["delivered"] >= before  # the count goes on, not from zero
    assert account["offered"] >= account["delivered"] + account["lost_in_crash"]


INTRUDERS = ("nobody", "a foreign authority", "a node of another place", "another host")


def credentials_of(world: World, who: str, tmp_path: Path) -> str:
    viewer = world.authority / "host.viewer"
    if who == "nobody":
        return f"-{world.authority / 'ca.pem'}"
    if who == "a foreign authority":
        secure.create(tmp_path / "ca")
        own = secure.issue(tmp_path / "own", tmp_path / "ca", "node.trio.steer")
        return str(own.folder)
    if who == "a node of another place":
        return str(viewer / "nodes" / "node.trio.count")
    return str(viewer)


def intrude(world: World, tmp_path: Path) -> dict[str, dict[str, Any]]:
    """Run all intruders at once; return what each of them got."""
    sensor, compute = world.addresses["sensor"], world.addresses["compute"]
    points = [f"{host}:{port}" for host in (sensor, compute) for port in (7447, 7500, 7501, 7502)]
    began = {}
    for who in INTRUDERS:
        words = ("-m", "tests.pipeline.fleet.intruder", credentials_of(world, who, tmp_path))
        began[who] = world.start(DESK, *words, ",".join(points), "2")
    found = {}
    for who, popen in began.items():
        said, _ = popen.communicate(timeout=60)
        assert popen.returncode == 0, said
        found[who] = json.loads(said.splitlines()[-1])
    return found


def test_intruders_get_nothing_and_disturb_nothing(world: World, tmp_path: Path) -> None:
    before = {end: edge(world, *end)["account"] for end in SEEN}

    for who, got in intrude(world, tmp_path).items():
        own = "fovea/trio/capture/context/bytes" if who == "a node of another place" else ""
        assert {key.split(" ")[1] for key in got["read"]} <= {own}, who  # what its edge gives it
        mine = {key: said for key, said in got["answers"].items() if "/host.viewer/" in key}
        assert got["answers"].keys() == mine.keys(), who
        assert all("host.viewer may not" in said for said in mine.values())
        assert bool(mine) == (who == "another host")
        assert got["sent"] > 10, who

    commands = edge(world, "sensor", "capture.schedule")["account"]["delivered"]
    assert commands > before["sensor", "capture.schedule"]["delivered"] + 5
    for end, earlier in before.items():
        after = edge(world, *end)["account"]["dropped"]
        assert after.get("refused", 0) == earlier["dropped"].get("refused", 0)
        assert after.get("fenced", 0) == 0
    until(lambda: edge(world, "sensor", "capture.schedule")["account"]["delivered"] > commands + 10)


SEEN = (("sensor", "capture.schedule"), ("compute", "work.frame"), ("viewer", "count.frame"))


def test_a_graph_that_one_host_refuses_starts_nowhere(world: World, tmp_path: Path) -> None:
    other = world.graph.with_name("other.yaml")
    other.write_text(
        TRIO.replace("name: trio", "name: other").replace(
            "tests.samples:Steer", "tests.samples:Nosy"
        )
    )

    with pytest.raises(
        RunError, match=r"compute: steer\.operator: tests\.samples:Nosy is not on the"
    ):
        deploy(world, other)
    with pytest.raises(RunError, match="runs already; take it down first"):
        world.up()

    assert {state["graph"] for states in world.states().values() for state in states} == {"trio"}


def deploy(world: World, graph: Path) -> str:
    credentials = str(world.authority / user_identity("tester"))
    return world.fovea("up", str(graph), "--credentials", credentials)


def test_down_stops_the_graph_on_every_host_and_leaves_nothing(world: World) -> None:
    assert "trio: stopped" in world.fovea("down", "trio")

    left = [p for label in world.plan.hosts for p in world.home(label).rglob("*.recv")]
    assert left == []
    with pytest.raises(RunError, match="no graph trio runs"):
        world.fovea("down", "trio")
