"""Requests from a command line to the nodes of a graph that runs on several hosts."""

from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import msgspec

from pipeline.errors import FoveaError, RunError
from pipeline.fleet.deploy import READY_S, Fleet, carried, remembered, send_weights
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import decode, decode_answer
from pipeline.protocol.orders import RESULT, Result, SwapOrder
from pipeline.protocol.questions import (
    ConfigQuestion,
    Health,
    HealthQuestion,
    NodeQuestion,
    NodeSettings,
)
from pipeline.settings import suggest

ASK_S = 8.0  # the node's own timeout, and the way
AT_ONCE = 4  # nodes; one that hangs must not hold up the others


def is_deployed(graph: str) -> bool:
    """Whether this graph was brought up on hosts from here."""
    return graph in remembered()


def ask_there(graph: str, node: str, question: NodeQuestion) -> bytes:
    """What a node on one of the hosts answers; raises `FoveaError` with the reason."""
    with _way(graph, node) as (fleet, label):
        return _ask(fleet, label, graph, node, question)


def set_there(graph: str, node: str, changes: Mapping[str, Any]) -> NodeSettings:
    """Change live settings; files go along as at `fovea up`. Raises `FoveaError` with the reason.

    What is no live setting is refused before a file is sent.
    """
    with _way(graph, node) as (fleet, label):
        moved, files = carried(changes)
        if files:
            asked = _ask(fleet, label, graph, node, ConfigQuestion())
            live = decode_answer(NodeSettings, asked).live
            _check_live(graph, node, [n for n in changes if moved[n] != changes[n]], live)
            _send(fleet, label, files)
        return decode_answer(NodeSettings, _ask(fleet, label, graph, node, ConfigQuestion(moved)))


def swap_there(graph: str, order: SwapOrder, timeout_s: float) -> Result:
    """Have a node on one of the hosts swapped; raises `FoveaError` with the reason."""
    with _way(graph, order.node) as (fleet, label):
        changes, files = carried(order.changes)
        _send(fleet, label, files)
        order = msgspec.structs.replace(order, changes=changes)
        asked = wire.Change(graph, order)
        said = fleet.ask(label, "swap", asked, wire.Relayed, max(timeout_s, READY_S))
        return decode(RESULT, said.payload)


def health_there(graph: str) -> dict[str, Health | None]:
    """What every node on every host says; None for who is silent, or whose host is."""
    hosts = remembered()[graph]
    with Fleet(hosts) as fleet, ThreadPoolExecutor(AT_ONCE) as pool:
        there = {label for label, said in fleet.states(graph).items() if not isinstance(said, str)}

        def health(node: str) -> Health | None:
            label = hosts.nodes[node]
            if label not in there:
                return None
            try:
                asked = _ask(fleet, label, graph, node, HealthQuestion())
                return decode_answer(Health, asked)
            except FoveaError:
                return None

        return dict(zip(hosts.nodes, pool.map(health, hosts.nodes), strict=True))


def _ask(fleet: Fleet, label: str, graph: str, node: str, question: NodeQuestion) -> bytes:
    asked = wire.ToNode(graph, node, question)
    return fleet.ask(label, "node", asked, wire.Relayed, ASK_S).payload


def _send(fleet: Fleet, label: str, files: Mapping[str, Any]) -> None:
    lacking = fleet.ask(label, "lacks", wire.Lacks(tuple(files)), wire.Missing).digests
    send_weights(fleet, label, lacking, files)


def _check_live(graph: str, node: str, names: Collection[str], live: Collection[str]) -> None:
    for name in names:
        if name not in live:
            raise RunError(
                f"{node}.{name}: cannot change while the node runs; "
                f"`fovea swap {graph} {node} --set {name}=…` starts another one with it"
            )


@contextmanager
def _way(graph: str, node: str) -> Iterator[tuple[Fleet, str]]:
    hosts = remembered()[graph]
    if node not in hosts.nodes:
        raise RunError(f"{graph}: no node {node}{suggest(node, hosts.nodes)}")
    with Fleet(hosts) as fleet:
        yield fleet, hosts.nodes[node]
