"""The client of a local graph also listens to and changes a graph over several hosts."""

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from pipeline.client import listening
from pipeline.client.deployed import DeployedGraph
from pipeline.client.find import find
from pipeline.errors import FoveaError, RunError, SettingsError
from pipeline.fleet.deploy import Fleet, down, up
from pipeline.fleet.hosted_graph import HostedGraph, change, check_inside
from pipeline.fleet.remembered import remembered
from pipeline.protocol import fleet as wire
from pipeline.protocol.orders import SwapOrder, TopologyResult
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
from tests.samples import Pass, WorkSettings

pytestmark = pytest.mark.hosts

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


def goes_on(fleet: Fleet, label: str, node: str) -> None:
    before = handled(fleet, label, node, "duo")
    until(lambda: handled(fleet, label, node, "duo") > before + 5)


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


def test_a_swap_survives_restarts_of_the_graph_and_of_the_agent(
    two: dict[str, Running], fleet: Fleet, tmp_path: Path
) -> None:
    def work_has_state() -> bool:
        try:
            settings = find("duo").configure("work", {}).settings
        except FoveaError:  # it starts
            return False
        assert (settings["hold"], settings["every"]) == (2, 1)
        return find("duo").schema("work").operator == "tests.samples:PassEvery"

    until(lambda: handled(fleet, "brain", "count", "duo") > 10)
    order = SwapOrder(node="work", operator="tests.samples:PassEvery", changes={"hold": 2})
    find("duo").swap(order)
    supervisor = two["brain"].agent.hosted["duo"].supervisor
    assert supervisor is not None

    supervisor.manager.failure = "made to fail"

    until(lambda: two["brain"].agent.hosted["duo"].supervisor not in (None, supervisor))
    until(work_has_state)
    find("duo").add(more(tmp_path))  # nor does a change of other nodes
    assert work_has_state()
    two["brain"].stop()
    two["brain"] = Running(host_of("brain", LABELS, tmp_path))
    until(lambda: phases(fleet, "brain", "duo") == ["running"])
    until(work_has_state)
    goes_on(fleet, "brain", "tally")


def test_a_swap_asks_for_advice_with_what_runs_on_all_hosts(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def advise(
        cls: type, settings: WorkSettings, upstream: Mapping[str, Any]
    ) -> Iterable[str]:  # only this process asks
        rate_hz = upstream["frame"].rate_hz
        if settings.every > rate_hz:
            raise SettingsError(f"every: expected at most {rate_hz:.0f}, got {settings.every}")
        return ["warning: few pictures"] if settings.every > 1 else []

    monkeypatch.setattr(Pass, "advise", classmethod(advise))
    client = find("duo")
    until(lambda: handled(fleet, "brain", "count", "duo") > 10)

    with caplog.at_level("WARNING", "pipeline.client"):
        for every in (1, 2, 31):
            client.swap(SwapOrder(node="work", changes={"every": every}))

    assert caplog.messages == ["work: few pictures", "work.every: expected at most 30, got 31"]
    assert client.configure("work", {}).settings["every"] == 31  # its host may know better


def test_a_change_of_a_part_on_its_own_host_is_told_to_last_until_it_starts_again(
    fleet: Fleet, caplog: pytest.LogCaptureFixture
) -> None:
    until(lambda: handled(fleet, "brain", "count", "duo") > 10)

    with caplog.at_level("WARNING", "pipeline.client.local"):
        find("duo@brain").swap(SwapOrder(node="work", changes={"every": 2}))
        find("duo").swap(SwapOrder(node="work", changes={"every": 1}))

    assert caplog.messages == [
        "duo@brain: lasts until this part starts again; a change of duo where it was brought up "
        "is kept"
    ]


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


def test_a_host_changes_nothing_but_its_own_nodes(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, DUO)
    fewer = plan_of(tmp_path, DUO[: DUO.index("  count:")])
    other = plan_of(tmp_path, DUO.replace("rate_hz: 30", "rate_hz: 20"))

    check_inside(plan, fewer, "brain")
    for wanted, label in ((fewer, "eye"), (other, "brain")):
        with pytest.raises(RunError, match=r"expected the (nodes|edges) of other hosts"):
            check_inside(plan, wanted, label)


def test_exposures_reach_no_host_that_does_not_know_their_clock(tmp_path: Path) -> None:
    nodes = """
  own: {operator: tests.samples:Ticker, host: brain}
  second: {operator: tests.samples:Pass, host: brain, inputs: {frame: own.context}}
  shown: {operator: tests.samples:Count, host: desk, inputs: {frame: second}}
"""
    text = DUO.replace("[eye, brain]", "[eye, brain, desk]") + nodes
    plan = plan_of(tmp_path, text)
    wanted = plan_of(tmp_path, text.replace("own.context", "work"))

    with pytest.raises(RunError, match=r"between eye and desk.* deploy the graph again with"):
        check_inside(plan, wanted, "brain")


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
    change(hosted, asked, agent._store, agent._admission.inspected, lambda _: changed.set())

    def end_late(hosted: HostedGraph) -> None:
        take(*orders[0])  # the supervisor carries it out when the state has been forgotten
        assert changed.wait(30)
        end(hosted)

    monkeypatch.setattr(HostedGraph, "end", end_late)
    fleet.ask("brain", "down", wire.Named("duo"), wire.Accepted, 60)
    monkeypatch.setattr(HostedGraph, "end", end)

    assert agent._store.names() == []


def test_a_tap_ends_when_its_graph_is_taken_down(fleet: Fleet) -> None:
    lines = listening.echo(find("duo").listen("work"), 0)
    next(lines)
    down("duo", fleet.hosts)

    rest = list(lines)

    assert isinstance(rest[-1], str)
    assert "duo" in rest[-1]
