"""One deployed graph is listened to and refuses orders; no test here changes it."""

import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from pipeline.bus.network import Network
from pipeline.bus.session import Session
from pipeline.bus.tap import Heard
from pipeline.client import listening
from pipeline.client.deployed import DeployedGraph
from pipeline.client.described import Described
from pipeline.client.find import find
from pipeline.client.graph_client import Listener
from pipeline.client.listening import Rate
from pipeline.errors import FoveaError, RunError, Silent
from pipeline.fleet import relay
from pipeline.fleet.deploy import Fleet, down, up
from pipeline.fleet.links import asker_permits
from pipeline.fleet.names import agent_key, host_identity
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import decode_answer
from pipeline.protocol.orders import TopologyResult
from tests.pipeline.fleet.agents import DUO, Running, agents, fleet_of, handled, plan_of, state_of
from tests.pipeline.fleet.test_deployed_client import (
    LABELS,
    MORE,
    goes_on,
    more,
    nodes_there,
    refusal,
)
from tests.sample_graphs import until

pytestmark = pytest.mark.hosts

NODES = {"eye": ["capture"], "brain": ["work", "count"]}


@dataclass(frozen=True)
class Deployed:
    """A running graph, its agents, and the home from which it was deployed."""

    home: Path
    agents: dict[str, Running]
    fleet: Fleet


@pytest.fixture(scope="module")
def deployed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployed]:
    """Deploy the graph of all tests here."""
    home, folder = tmp_path_factory.mktemp("home"), tmp_path_factory.mktemp("duo")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOME", str(home))
        with agents(folder, *LABELS) as running, fleet_of(*LABELS) as fleet:
            up(fleet, plan_of(folder, DUO))
            yield Deployed(home, running, fleet)
            down("duo", fleet.hosts)


@pytest.fixture
def fleet(deployed: Deployed, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    """Yield the hosts, and check that the test has changed nothing on them."""
    monkeypatch.setenv("HOME", str(deployed.home))
    assert nodes_there(deployed.fleet) == NODES
    yield deployed.fleet
    assert nodes_there(deployed.fleet) == NODES


def rates(
    listener: Listener, duration_s: float, monkeypatch: pytest.MonkeyPatch
) -> tuple[Rate, float]:
    """Return what `hz` measures, and the rate at which the source exposed the same messages."""
    told, figures = [], listening.figures

    def look(output: str, heard: Sequence[Heard], *more: Any) -> Rate:
        told.extend(heard)
        return figures(output, heard, *more)

    monkeypatch.setattr(listening, "figures", look)
    found = listening.rate(listener, duration_s)
    first, last = told[0].header, told[-1].header
    return found, (last.seq - first.seq) * 1e9 / (last.stamp_ns - first.stamp_ns)


def test_an_output_on_another_host_is_heard_and_its_rate_is_that_of_its_source(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = find("duo")
    until(lambda: handled(fleet, "brain", "count", "duo") > 10)

    heard = [
        item for item in listening.echo(client.listen("work"), 20) if isinstance(item, Described)
    ]
    found, exposed_hz = rates(client.listen("capture.roi"), 2.0, monkeypatch)

    assert [item.header.seq for item in heard] == sorted({item.header.seq for item in heard})
    assert len(heard) == 20
    assert heard[0].values["pixels"].ndim == 3
    assert found.rate_hz == pytest.approx(exposed_hz, rel=0.3)
    assert found.age_ms_p50 is not None
    assert 0 <= found.age_ms_p50 < 2000
    assert "work has no output rio" in refusal(lambda: client.listen("work.rio"))
    assert "no node wrk, did you mean 'work'" in refusal(lambda: client.listen("wrk"))


def test_messages_that_a_relay_has_no_room_for_are_counted_as_missed(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(relay, "MOST_KEPT", 2)
    monkeypatch.setattr("pipeline.client.relayed.POLL_S", 0.5)

    found, exposed_hz = rates(find("duo").listen("capture.roi"), 3.0, monkeypatch)

    assert found.missed["slow"] > 5
    assert found.rate_hz == pytest.approx(exposed_hz, rel=0.3)  # what was missed counts


def test_taps_are_bounded_and_closed_when_they_are_idle(
    deployed: Deployed, fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(tap: str, output: str = "out") -> wire.TapQuestion:
        return wire.TapQuestion("duo", "work", output, tap)

    monkeypatch.setattr(relay, "IDLE_S", 600.0)
    agent = deployed.agents["brain"].agent
    for number in range(relay.MOST_TAPS):
        fleet.ask("brain", "tap", asked(f"t{number}"), wire.TapMessages)
    with pytest.raises(RunError, match="busy: expected up to 8 taps"):
        fleet.ask("brain", "tap", asked("one-more"), wire.TapMessages)
    with pytest.raises(RunError, match="listens to another output already"):
        fleet.ask("brain", "tap", asked("t0", "other"), wire.TapMessages)
    agent._taps.fetch(
        agent.hosted["duo"], asked("t0"), "user.other"
    )  # another user has a limit of its own
    for name in ("", "a/b", "x" * 100_000):
        with pytest.raises(FoveaError, match="tap: expected up to 32 letters"):
            fleet.ask("brain", "tap", asked(name), wire.TapMessages)

    monkeypatch.setattr(relay, "IDLE_S", 0.0)
    until(lambda: not agent._taps._taps)


def test_a_tap_that_takes_long_to_open_delays_no_other_question(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    opens, go_on, session = threading.Event(), threading.Event(), relay.client_session

    @contextmanager
    def slow_session(*words: Any) -> Iterator[Session]:
        opens.set()
        assert go_on.wait(30)
        with session(*words) as opened:
            yield opened

    def tap() -> wire.TapMessages:
        asked = wire.TapQuestion("duo", "work", "out", "slow")
        return fleet.ask("brain", "tap", asked, wire.TapMessages, 60)

    monkeypatch.setattr(relay, "client_session", slow_session)
    monkeypatch.setattr(relay, "IDLE_S", 0.0)  # nor is it closed while it opens
    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(tap)
        try:
            assert opens.wait(30)
            assert state_of(fleet, "brain", "duo").phase == "running"
            assert found.running()
        finally:
            go_on.set()
        assert found.result(60).skipped == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (MORE.replace("host: eye", "host: brain"), "an edge between hosts cannot be added"),
        (MORE.replace("samples:Count", "samples:Tally"), r"Tally is not on the allow list"),
        (MORE.replace("    host: eye\n", ""), r"near\.host: expected a host"),
        (MORE.replace("second:", "work:"), "there is a node of that name already"),
    ],
)
def test_an_addition_that_may_not_run_is_refused_and_changes_nothing(
    fleet: Fleet, tmp_path: Path, text: str, said: str
) -> None:
    client = find("duo")
    before = nodes_there(fleet)

    with pytest.raises(FoveaError, match=said):
        client.add(more(tmp_path, text))

    assert nodes_there(fleet) == before
    goes_on(fleet, "brain", "count")


def test_a_change_is_also_undone_on_a_host_whose_answer_was_lost(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, change, lost = nodes_there(fleet), DeployedGraph._change, []

    def change_unheard(self: DeployedGraph, *words: Any) -> TopologyResult:
        result = change(self, *words)
        if not lost:
            lost.append(result)
            raise Silent("its answer was lost")
        return result

    monkeypatch.setattr(DeployedGraph, "_change", change_unheard)

    assert "its answer was lost" in refusal(lambda: find("duo").add(more(tmp_path)))

    assert lost[0].added == ["second", "tally"]
    assert nodes_there(fleet) == before


def test_an_edge_between_hosts_stays_as_it_was_deployed(fleet: Fleet) -> None:
    client = find("duo")

    assert refusal(lambda: client.rewire("work.frame=capture.roi")) == (
        "duo: capture.context is on eye, work.frame on brain: an edge between hosts cannot be cut "
        "while the graph runs; change the graph's file and bring it up again with "
        "`fovea up FILE --replace`"
    )
    assert "reads it" in refusal(lambda: client.remove("capture"))


def test_a_host_may_not_listen_or_change_the_plan_and_noise_is_refused(fleet: Fleet) -> None:
    permits = asker_permits(host_identity("brain"), {"eye": fleet.hosts.points["eye"]})
    way = Network(connect=(fleet.hosts.points["eye"],), permits=permits)
    session = Session.across(way)
    try:
        for verb in ("tap", "plan", "replan"):
            said = session.ask(agent_key("eye", host_identity("brain"), verb), b"x", 5)
            assert said is not None
            with pytest.raises(RunError, match=rf"host\.brain may not {verb} here"):
                decode_answer(wire.TapMessages, said)
    finally:
        session.close()
    for verb in ("tap", "plan", "replan"):
        for data in (b"", b"{", b"[]", b"\xff" * 50):
            with pytest.raises(FoveaError):
                fleet.ask("eye", verb, data, wire.TapMessages)
