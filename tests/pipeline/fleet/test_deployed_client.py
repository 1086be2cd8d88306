"""The client of a local graph also listens to and changes a graph over several hosts."""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
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
from pipeline.fleet.deploy import Fleet, down, remembered, up
from pipeline.fleet.hosted_graph import HostedGraph, change, check_inside
from pipeline.fleet.links import asker_permits
from pipeline.fleet.names import agent_key, host_identity
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import decode_answer
from pipeline.protocol.orders import TopologyResult
from tests.pipeline.fleet.agents import (
    DUO,
    Running,
    agents,
    fleet_of,
    handled,
    host_of,
    phases,
    plan_of,
    state_of,
)
from tests.sample_graphs import until

MORE = """
nodes:
  second:
    operator: tests.samples:Pass
    host: brain
    inputs: {frame: work}
  tally:
    operator: tests.samples:Count
    host: brain
    inputs: {frame: second}
  near:
    operator: tests.samples:Count
    host: eye
    inputs: {frame: capture.roi}
"""
LABELS = ("eye", "brain")


@pytest.fixture
def two(tmp_path: Path) -> Iterator[dict[str, Running]]:
    with agents(tmp_path, *LABELS) as running:
        yield running


@pytest.fixture
def fleet(two: dict[str, Running], tmp_path: Path) -> Iterator[Fleet]:
    with fleet_of(*LABELS) as fleet:
        up(fleet, plan_of(tmp_path, DUO))
        yield fleet
        down("duo", fleet.hosts)


def more(folder: Path, text: str = MORE) -> Path:
    path = folder / "more.yaml"
    path.write_text(text)
    return path


def refusal(act: Callable[[], Any]) -> str:
    with pytest.raises(FoveaError) as caught:
        act()
    return str(caught.value)


def nodes_there(fleet: Fleet, *labels: str) -> dict[str, list[str]]:
    labels = labels or LABELS
    return {label: [n.name for n in state_of(fleet, label, "duo").nodes] for label in labels}


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


def goes_on(fleet: Fleet, label: str, node: str) -> None:
    before = handled(fleet, label, node, "duo")
    until(lambda: handled(fleet, label, node, "duo") > before + 5)


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
    two: dict[str, Running], fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(tap: str, output: str = "out") -> wire.TapQuestion:
        return wire.TapQuestion("duo", "work", output, tap)

    monkeypatch.setattr(relay, "IDLE_S", 600.0)
    agent = two["brain"].agent
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


def test_nodes_are_added_on_both_hosts_rewired_and_removed_while_the_graph_runs(
    two: dict[str, Running], fleet: Fleet, tmp_path: Path
) -> None:
    client = find("duo")
    until(lambda: handled(fleet, "brain", "count", "duo") > 10)

    added = client.add(more(tmp_path))

    assert sorted(added.added) == ["near", "second", "tally"]
    assert set(added.connected) == {
        "capture.roi -> near.frame", "work -> second.frame", "second -> tally.frame"
    }  # fmt: skip
    goes_on(fleet, "brain", "tally")
    goes_on(fleet, "eye", "near")
    assert remembered()["duo"].nodes["near"] == "eye"
    rewired = find("duo").rewire("tally.frame=work")
    assert rewired.cut == ["second -> tally.frame"]
    assert find("duo").remove("second").removed == ["second"]
    goes_on(fleet, "brain", "tally")
    assert "second" not in remembered()["duo"].nodes
    kept = two["brain"].agent._store.asked("duo")
    assert set(kept.fingerprints) == {edge.origin for edge in kept.plan.edges}

    two["brain"].stop()  # the changes and the edge between hosts survive a restart
    two["brain"] = Running(host_of("brain", LABELS, tmp_path))
    until(lambda: phases(fleet, "brain", "duo") == ["running"])
    goes_on(fleet, "brain", "tally")
    assert {n.name for n in state_of(fleet, "brain", "duo").nodes} == {"work", "count", "tally"}


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


def test_a_change_is_undone_when_the_next_host_does_not_answer(
    two: dict[str, Running], fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change = DeployedGraph._change

    def change_one(self: DeployedGraph, fleet: Fleet, label: str, *words: Any) -> TopologyResult:
        if label == "eye":
            assert "second" in nodes_there(fleet, "brain")["brain"]
            two["eye"].stop()
        return change(self, fleet, label, *words)

    monkeypatch.setattr(DeployedGraph, "_change", change_one)
    monkeypatch.setattr("pipeline.client.deployed.ORDER_S", 5.0)
    try:
        assert "eye: no agent answers" in refusal(lambda: find("duo").add(more(tmp_path)))
        assert nodes_there(fleet, "brain") == {"brain": ["work", "count"]}
    finally:
        two["eye"] = Running(host_of("eye", LABELS, tmp_path))


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


def test_a_host_changes_nothing_but_its_own_nodes(fleet: Fleet, tmp_path: Path) -> None:
    plan = plan_of(tmp_path, DUO)
    fewer = plan_of(tmp_path, DUO[: DUO.index("  count:")])
    other = plan_of(tmp_path, DUO.replace("rate_hz: 30", "rate_hz: 20"))

    check_inside(plan, fewer, "brain")
    for wanted, label in ((fewer, "eye"), (other, "brain")):
        with pytest.raises(RunError, match=r"expected the (nodes|edges) of other hosts"):
            check_inside(plan, wanted, label)


def test_a_graph_that_is_taken_down_while_it_changes_does_not_come_back(
    two: dict[str, Running], fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent, fewer = two["brain"].agent, plan_of(tmp_path, DUO[: DUO.index("  count:")])
    until(lambda: handled(fleet, "brain", "count", "duo") > 3)
    now = fleet.ask("brain", "plan", wire.Named("duo"), wire.Planned)
    told = agent._store.asked("duo").fingerprints
    asked = wire.PlanChange("duo", fewer, wire.Versions.ours(), told, now.revision)
    hosted, changed, end = agent.hosted["duo"], threading.Event(), HostedGraph.end
    assert hosted.supervisor is not None
    control, orders = hosted.supervisor.control, []
    take = control.ask
    monkeypatch.setattr(control, "ask", lambda *order: orders.append(order))
    change(hosted, asked, agent._store, agent._inspected, lambda _: changed.set())

    def end_late(hosted: HostedGraph) -> None:
        take(*orders[0])  # the supervisor carries it out when the state has been forgotten
        assert changed.wait(30)
        end(hosted)

    monkeypatch.setattr(HostedGraph, "end", end_late)
    fleet.ask("brain", "down", wire.Named("duo"), wire.Accepted, 60)
    monkeypatch.setattr(HostedGraph, "end", end)

    assert agent._store.names() == []


def test_a_host_may_not_listen_or_change_the_plan_and_noise_is_refused(fleet: Fleet) -> None:
    permits = asker_permits(host_identity("brain"), ["eye"])
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


def test_a_tap_ends_when_its_graph_is_taken_down(fleet: Fleet) -> None:
    lines = listening.echo(find("duo").listen("work"), 0)
    next(lines)
    down("duo", fleet.hosts)

    rest = list(lines)

    assert isinstance(rest[-1], str)
    assert "duo" in rest[-1]
