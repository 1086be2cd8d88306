"""Questions and orders from a desk to nodes of a graph that runs on several boxes."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import msgspec

from pipeline.errors import RunError
from pipeline.fleet import wire
from pipeline.fleet.deploy import READY_S, Fleet, carried, remembered, send_weights
from pipeline.run.swap import SwapOrder
from pipeline.settings import suggest

ASK_S = 8.0  # the node's own patience, and the way


def is_deployed(graph: str) -> bool:
    """Whether this graph was brought up on boxes from here."""
    return graph in remembered()


def ask_there(graph: str, node: str, question: str, payload: bytes) -> bytes:
    """What a node on one of the boxes answers; raises `FoveaError` with the reason."""
    with _way(graph, node) as (fleet, label):
        asked = wire.ToNode(graph, node, cast(wire.Question, question), payload)
        return fleet.ask(label, "node", asked, wire.Said, ASK_S).payload


def swap_there(graph: str, order: SwapOrder, patience_s: float) -> dict[str, Any]:
    """Have a node on one of the boxes swapped; raises `FoveaError` with the reason."""
    with _way(graph, order.node) as (fleet, label):
        changes, files = carried(order.changes)
        lacking = fleet.ask(label, "lacks", wire.Lacks(tuple(files)), tuple[str, ...])
        send_weights(fleet, label, lacking, files)
        order = msgspec.structs.replace(order, changes=changes)
        asked = wire.Change(graph, order)
        return fleet.ask(label, "swap", asked, dict[str, Any], max(patience_s, READY_S))


@contextmanager
def _way(graph: str, node: str) -> Iterator[tuple[Fleet, str]]:
    hosts = remembered()[graph]
    if node not in hosts.nodes:
        raise RunError(f"{graph}: no node {node}{suggest(node, hosts.nodes)}")
    with Fleet(hosts) as fleet:
        yield fleet, hosts.nodes[node]
