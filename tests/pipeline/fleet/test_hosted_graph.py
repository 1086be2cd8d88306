"""One host's part of a graph, without processes: what it stores of a change."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.errors import RunError
from pipeline.fleet.agent_file import GraphStore
from pipeline.fleet.hosted_graph import identity_of, keep_swap, reply_kept
from pipeline.graph.plan import Node, Plan
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import decode_answer, encode
from pipeline.protocol.orders import SwapOrder, SwapResult

PLAN = Plan(
    name="g",
    clock="realtime",
    nodes=(Node(index=0, name="work", operator="m:Old", settings={"gain": 2}, host="here"),),
    edges=(),
    hosts=("here",),
)
START = wire.Start(PLAN, wire.Versions.ours(), {}, {}, {})
SWAPPED = encode(SwapResult(node="work", hot=True, gap_ms=0, state="", proven_frames=1))


@pytest.fixture
def store(tmp_path: Path) -> GraphStore:
    store = GraphStore(tmp_path)
    store.keep("g", START)
    return store


def hosted_graph() -> Any:
    """Return a stand-in for a `HostedGraph` of which nothing runs."""
    manager = SimpleNamespace(ports_of=lambda node: f"ports of {node.operator}")
    supervisor = SimpleNamespace(manager=manager)
    return SimpleNamespace(plan=replace(PLAN, here="here"), ports={}, supervisor=supervisor)


def test_a_swap_is_stored_as_it_came_and_runs_again_with_the_files_of_the_host(
    store: GraphStore,
) -> None:
    hosted = hosted_graph()
    asked = SwapOrder(node="work", operator="m:New", changes={"weights": "sha256:12"})
    local = SwapOrder(node="work", operator="m:New", changes={"weights": "/w/12", "device": "d"})

    keep_swap(hosted, hosted.supervisor, asked, local, store)

    (node,), (stored,) = hosted.plan.nodes, store.asked("g").plan.nodes
    assert node.settings == {"gain": 2, "weights": "/w/12", "device": "d"}
    assert stored.settings == {"gain": 2, "weights": "sha256:12"}
    assert node.operator == stored.operator == "m:New"
    assert hosted.ports == {"m:New": "ports of m:New"}
    assert identity_of(store.asked("g")) == identity_of(START)  # its partners know it by that


def test_a_change_that_cannot_be_stored_is_told(tmp_path: Path) -> None:
    hosted, order = hosted_graph(), SwapOrder(node="work")
    nothing, replies = GraphStore(tmp_path / "gone"), list[bytes]()

    reply_kept(
        SWAPPED, lambda: keep_swap(hosted, hosted.supervisor, order, order, nothing), replies.append
    )

    (said,) = replies
    with pytest.raises(RunError, match="it was changed, but a restart will lose it: "):
        decode_answer(wire.Relayed, said)
