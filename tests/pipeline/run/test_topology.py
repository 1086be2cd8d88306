"""Nodes and edges are added and removed while a graph runs, without disturbing the others."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline import FoveaError
from pipeline.client.find import find
from pipeline.graph.editing import rewired, with_nodes, without_node
from pipeline.graph.plan import Plan
from pipeline.protocol.orders import TopologyResult
from pipeline.run.rundir import running
from pipeline.run.supervisor import Supervisor
from tests.sample_graphs import (
    LOSSLESS,
    apart,
    assert_accounts_add_up,
    edge,
    go,
    handled,
    plan_of,
    until,
    wait_for,
)

SECOND = """\
nodes:
  second:
    operator: tests.samples:Count
    inputs: {frame: {from: work, depth: 60}}
"""
Order = Callable[..., TopologyResult]


def addition(tmp_path: Path, text: str = SECOND) -> Path:
    path = tmp_path / "more.yaml"
    path.write_text(text)
    return path


def operating(
    plan: Plan, acts: Callable[[Order, Supervisor], None]
) -> Callable[[Supervisor], None]:
    """Return a function that does `acts` in another thread while the supervisor ticks."""

    def during(supervisor: Supervisor) -> None:
        broken: list[BaseException] = []

        def run() -> None:
            try:
                acts(
                    lambda edit, *words: find(plan.name).replan(lambda p: edit(p, *words)),
                    supervisor,
                )
            except (
                BaseException
            ) as error:  # an assertion, too; it is raised again in the main thread
                broken.append(error)

        wait_for(supervisor, lambda: handled(supervisor, "work") > 3)
        operator = threading.Thread(target=run)
        operator.start()
        wait_for(supervisor, lambda: not operator.is_alive(), 60)
        supervisor.finish()
        if broken:
            raise broken[0]

    return during


@pytest.mark.lengthy
def test_a_consumer_is_added_and_removed_and_the_others_lose_no_frame(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOSSLESS)
    lost: list[int] = []

    def acts(order: Order, supervisor: Supervisor) -> None:
        for _ in range(2):
            told = order(with_nodes, addition(tmp_path))
            assert told.added == ["second"]
            assert told.connected == ["work -> second.frame"]
            until(lambda: handled(supervisor, "second") > 10)
            account = supervisor.ledger.edges[supervisor.plan.inputs("second")["frame"].index]
            lost.append(account.lost_in_crash)
            assert order(without_node, "second").removed == ["second"]
            assert "second" not in supervisor.processes

    report = go(plan, 0, operating(plan, acts))

    frames = report["frames"]["exposed"]
    assert report["summaries"]["count"] == {"seen": list(range(frames)), "torn": 0}
    assert lost == [0, 0]
    for end in ("work.frame", "count.frame"):
        assert edge(report, end)["dropped"] == {}
        assert edge(report, end)["delivered"] == frames
    second = report["summaries"]["second"]
    first = second["seen"][0]
    assert second == {"seen": list(range(first, first + len(second["seen"]))), "torn": 0}


def test_settings_told_to_a_node_are_not_those_of_the_next_one_of_its_name(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOSSLESS)
    text = SECOND.replace("samples:Count", "samples:Pass")
    told: list[dict[str, Any]] = []

    def acts(order: Order, supervisor: Supervisor) -> None:
        for every in (7, 5):
            order(with_nodes, addition(tmp_path, f"{text}    settings: {{every: 1}}\n"))
            until(lambda: handled(supervisor, "second") > 2)
            client = find(plan.name)
            told.append(client.configure("second", {}).settings)
            client.configure("second", {"every": every})
            order(without_node, "second")

    go(plan, 0, operating(plan, acts))

    assert [settings["every"] for settings in told] == [1, 1]


def test_an_edge_is_rewired_between_two_frames(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, apart(LOSSLESS), changes=("work.every=1000000",))

    def acts(order: Order, supervisor: Supervisor) -> None:
        before = supervisor.pid("count")
        told = order(rewired, "count.frame=ticker.roi")
        assert told.connected == ["ticker.roi -> count.frame"]
        assert told.cut == ["work -> count.frame"]
        after = handled(supervisor, "count")
        until(lambda: handled(supervisor, "count") > after + 20)
        assert supervisor.pid("count") == before
        assert (
            supervisor.ledger.edges[1].accounted == 0
        )  # the old edge has ended for writer and reader

    report = go(plan, 0, operating(plan, acts))

    seen = report["summaries"]["count"]["seen"]
    assert report["summaries"]["count"]["torn"] == 0
    assert seen == [0, *range(seen[1], report["frames"]["exposed"])]
    assert report["restarts"] == {}


@pytest.mark.parametrize(
    ("edit", "words", "said"),
    [
        (without_node, "cnt", "no node cnt, did you mean 'count'?"),
        (without_node, "work", "work: count.frame reads it"),
        (rewired, "count.frame=tickr", "count.inputs.frame: no node tickr"),
        (rewired, "count.frame=ticker.rio", "ticker has no output rio, did you mean 'ticker.roi'"),
        (rewired, "count.fame=work", "count.fame: no such edge, did you mean 'frame'?"),
        (rewired, "count.frame", "expected node.input=source"),
        (rewired, "work.frame=work", "wait for one another"),
        (with_nodes, SECOND.replace("second", "count"), "there is a node of that name already"),
        (with_nodes, SECOND.replace("Count", "Steer"), "more.yaml:4: second.inputs.frame: no such"),
        (with_nodes, SECOND.replace("work", "wrok"), "more.yaml:4: second.inputs.frame: no node"),
        (with_nodes, "nodes: {}\nclock: lockstep\n", "addition.clock: no such key"),
    ],
)
def test_what_the_loader_would_refuse_is_refused(
    tmp_path: Path, edit: Callable[..., Plan], words: str, said: str
) -> None:
    plan = plan_of(tmp_path, LOSSLESS)

    with pytest.raises(FoveaError) as refusal:
        edit(plan, addition(tmp_path, words) if edit is with_nodes else words)

    assert said in str(refusal.value)


@pytest.mark.lengthy
def test_an_addition_that_does_not_start_leaves_the_graph_as_it_was(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOSSLESS)
    text = SECOND.replace("Count", "Stillborn")

    def acts(order: Order, supervisor: Supervisor) -> None:
        with pytest.raises(FoveaError, match="never meant to live"):
            order(with_nodes, addition(tmp_path, text))
        assert "second" not in supervisor.processes
        order(with_nodes, addition(tmp_path))

    report = go(plan, 0, operating(plan, acts))

    assert report["failure"] == ""
    assert report["summaries"]["count"]["seen"] == list(range(report["frames"]["exposed"]))
    assert_accounts_add_up(report)


SLOW = """\
nodes:
  slow:
    operator: tests.faulty_samples:Sick
    inputs: {frame: {from: work, depth: 60}}
    settings: {open_s: 3, ill_from: 1000000}
"""


def test_an_added_node_that_opens_slowly_has_a_process_and_is_not_gone(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, LOSSLESS)
    noted: list[dict[str, Any]] = []

    def acts(order: Order, supervisor: Supervisor) -> None:
        adding = threading.Thread(target=order, args=(with_nodes, addition(tmp_path, SLOW)))
        adding.start()
        until(lambda: "slow" in running()[plan.name]["pids"] or not adding.is_alive())
        noted.append(running()[plan.name] | {"opens": adding.is_alive()})
        adding.join()

    go(plan, 0, operating(plan, acts))

    assert noted[0]["opens"]
    assert noted[0]["gone"] == []
