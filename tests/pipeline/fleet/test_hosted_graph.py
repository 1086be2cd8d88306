"""One host's part of a graph, without processes: pauses between runs, what a change stores."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.errors import RunError
from pipeline.fleet import hosted_graph
from pipeline.fleet.agent_file import GraphStore
from pipeline.fleet.hosted_graph import (
    HEALTHY_S,
    HostedGraph,
    carry_out,
    change,
    identity_of,
    keep_swap,
    planned,
)
from pipeline.graph.plan import Node, Plan
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import MOST_BYTES, decode_answer, encode, refused
from pipeline.protocol.orders import SwapOrder, SwapResult, TopologyResult

PLAN = Plan(
    name="g",
    clock="realtime",
    nodes=(Node(index=0, name="work", operator="m:Old", settings={"gain": 2}, host="here"),),
    edges=(),
    hosts=("here",),
)
START = wire.Start(PLAN, wire.Versions.ours(), {}, {}, {})
SWAPPED = encode(SwapResult(node="work", hot=True, gap_ms=0, state="", proven_frames=1))

ADDED = encode(TopologyResult(added=["second"], removed=[], connected=[], cut=[]))


@pytest.fixture
def store(tmp_path: Path) -> GraphStore:
    store = GraphStore(tmp_path)
    store.keep("g", START)
    return store


def stand_in() -> Any:
    """Return a stand-in for a `HostedGraph` of which nothing runs."""
    manager = SimpleNamespace(ports_of=lambda node: f"ports of {node.operator}")
    supervisor = SimpleNamespace(manager=manager, control=Orders(), revision=0)
    plan = replace(PLAN, here="here")
    return SimpleNamespace(plan=plan, ports={}, supervisor=supervisor, orders=set())


class Orders:
    """A stand-in for a `ControlServer`, which the test answers."""

    def __init__(self) -> None:
        self.replies: list[Callable[[bytes], None]] = []

    def ask(self, order: bytes, reply: Callable[[bytes], None]) -> None:
        self.replies.append(reply)


def test_a_swap_is_stored_as_it_came_and_runs_again_with_the_files_of_the_host(
    store: GraphStore,
) -> None:
    hosted = stand_in()
    asked = SwapOrder(node="work", operator="m:New", changes={"weights": "sha256:12"})
    local = SwapOrder(node="work", operator="m:New", changes={"weights": "/w/12", "device": "d"})

    keep_swap(hosted, hosted.supervisor, asked, local, store)

    (node,), (stored,) = hosted.plan.nodes, store.asked("g").plan.nodes
    assert node.settings == {"gain": 2, "weights": "/w/12", "device": "d"}
    assert stored.settings == {"gain": 2, "weights": "sha256:12"}
    assert node.operator == stored.operator == "m:New"
    assert hosted.ports == {"m:New": "ports of m:New"}
    assert identity_of(store.asked("g")) == identity_of(START)  # its partners know it by that


def test_what_is_stored_may_be_longer_than_the_change_that_was_accepted(store: GraphStore) -> None:
    most = start_of(MOST_BYTES)

    store.keep("g", most)

    assert store.asked("g") == most


def test_what_could_not_be_read_again_is_not_stored(store: GraphStore) -> None:
    with pytest.raises(RunError, match=r"g\.graph: expected up to \d+ bytes to store, got \d+"):
        store.keep("g", start_of(2 * MOST_BYTES))

    assert store.asked("g") == START


def start_of(size: int) -> wire.Start:
    """Return a start that takes a little more than that many bytes."""
    node = replace(PLAN.nodes[0], settings={"text": "x" * size})
    return wire.Start(replace(PLAN, nodes=(node,)), START.versions, {}, {}, {})


class Runs:
    """Runs of a graph that fail after some seconds each, and the pauses between them."""

    def __init__(self, *lengths_s: float) -> None:
        self.now_s, self.pauses_s = 100.0, list[float]()
        self._lengths_s = list(lengths_s)

    def monotonic(self) -> float:
        return self.now_s

    def run_once(self) -> None:
        self.now_s += self._lengths_s.pop(0)

    def is_set(self) -> bool:
        return False

    def wait(self, timeout_s: float) -> bool:
        self.pauses_s.append(timeout_s)
        return not self._lengths_s


def test_the_pause_before_a_restart_grows_until_a_run_was_healthy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    day_s = 86400.0
    runs = Runs(1, 1, 1, 1, 1, 1, HEALTHY_S, HEALTHY_S + 1, 1, day_s, day_s)
    monkeypatch.setattr(hosted_graph, "time", runs)
    hosted: Any = HostedGraph.__new__(HostedGraph)
    hosted._stop, hosted._proven, hosted._run_once = runs, True, runs.run_once

    hosted._run()

    assert runs.pauses_s == [1, 2, 4, 8, 16, 30, 30, 1, 2, 1, 1]


def test_a_change_that_cannot_be_stored_is_told(tmp_path: Path) -> None:
    hosted, order = stand_in(), SwapOrder(node="work")
    nothing, replies = GraphStore(tmp_path / "gone"), list[bytes]()

    keep = partial(keep_swap, hosted, hosted.supervisor, order, order, nothing)
    carry_out(hosted, hosted.supervisor, order, keep, replies.append)
    hosted.supervisor.control.replies[0](SWAPPED)

    (said,) = replies
    with pytest.raises(RunError, match="it was changed, but a restart will lose it: "):
        decode_answer(wire.Relayed, said)


@pytest.mark.parametrize("result", [ADDED, encode(refused("no"))])
def test_a_plan_is_not_told_while_it_changes(store: GraphStore, result: bytes) -> None:
    hosted, replies = stand_in(), list[bytes]()
    more = replace(PLAN, nodes=(*PLAN.nodes, replace(PLAN.nodes[0], index=1, name="second")))
    asked = wire.PlanChange("g", more, wire.Versions.ours(), {}, 0)
    change(hosted, asked, store, lambda plan, _: (replace(plan, here="here"), {}), replies.append)

    for hosted.supervisor.revision in (0, 2):  # until the new plan is stored
        with pytest.raises(RunError, match="g: is being changed, try again"):
            planned(hosted, store)
    hosted.supervisor.control.replies[0](result)

    assert decode_answer(wire.Relayed, replies[0]).payload == result
    assert planned(hosted, store) == wire.Planned(more if result == ADDED else PLAN, 2)


def test_a_plan_is_not_told_when_it_has_changed_while_it_was_read(store: GraphStore) -> None:
    hosted = stand_in()

    class Slow(GraphStore):
        def asked(self, graph: str) -> wire.Start:
            hosted.supervisor.revision += 1
            return store.asked(graph)

    with pytest.raises(RunError, match="g: is being changed, try again"):
        planned(hosted, Slow(Path()))
