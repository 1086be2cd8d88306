"""Attach a viewer to a running graph: a node of its own, which leaves again.

The node reads by taps, so that it disturbs no other. It is connected by the types of messages and
by the names of inputs that the graph's own consumers have. What the messages do not tell comes
from here: once a second the node is told of drops, restarts, swaps and settings.
"""

import json
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

from pipeline.client.graph_client import FREE_S, RETRY_S, GraphClient, Status, when_free
from pipeline.client.local import LocalGraph
from pipeline.errors import FoveaError, RunError
from pipeline.graph.editing import PortTypes, with_nodes
from pipeline.graph.plan import Plan
from pipeline.protocol.fleet import NodeState, Process

VIEWER = "operators.visualise:Visualise"  # by its path: no import of an operator here
NAME = re.compile(r"viewer_(\d+)")  # of its node, with the process that attached it
FRAMES = ("context", "roi", "roi_2", "roi_3", "roi_4")
BY_NAME = ("context", "roi", "full")  # outputs shown whether or not a node reads them
MESSAGES = {  # the viewer's other inputs, by the type of the message
    "Detections": "detections", "Tracks": "tracks", "Scanpath": "scanpath",
    "RoiSchedule": "schedule", "Percept": "percept", "Truth": "truth",
}  # fmt: skip
LOOK_S = 1.0
SETTINGS_LOOKS = 5  # settings are asked for at every fifth look
LEAVE_S = 10.0  # for the node to leave
MOST_TOLD = 50  # lines and counts of one look


@contextmanager
def attached(
    client: GraphClient, settings: Callable[[], Mapping[str, Any]], wait_s: float = FREE_S
) -> Iterator[str]:
    """Add a viewer to a graph, yield its node's name, and remove it.

    While the graph is busy with another order it waits, `wait_s` at most; `settings` is asked for
    at each try, since a port that was free may have been taken. Viewers that a killed command
    left are removed, too. Raises `FoveaError` when the graph is not
    on this host, or has nothing that can be shown.
    """
    if not isinstance(client, LocalGraph):
        raise RunError(
            f"{client.name}: expected a graph of this host, got one of several hosts; there a node "
            f"of the graph shows it: {VIEWER}"
        )
    clear_leftovers(client)
    name = f"viewer_{os.getpid()}"

    def with_viewer(plan: Plan) -> Plan:
        inputs = wiring(plan, client.ports)
        node = {"operator": VIEWER, "inputs": inputs, "settings": dict(settings())}
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "viewer.yaml"
            file.write_text(json.dumps({"nodes": {name: node}}))  # which is YAML, too
            return with_nodes(plan, file, client.ports)

    try:
        when_free(lambda: client.replan(with_viewer), wait_s)
        yield name
    finally:
        _remove(client, name)


def clear_leftovers(client: LocalGraph) -> None:
    """Remove the viewers of processes that have ended."""
    for node in client.nodes():
        found = NAME.fullmatch(node)
        if found and not psutil.pid_exists(int(found[1])):
            _remove(client, node)


def wiring(plan: Plan, ports_of: Callable[[str], PortTypes]) -> dict[str, str]:
    """Return what a viewer of this graph reads: input -> output.

    Frames are those that the graph's own nodes read by these names, as capture may send mosaics
    that cannot be shown; else the outputs of these names. Of several nodes that send a type, the
    last one is shown. Raises `RunError` without anything to show.
    """
    found: dict[str, str] = {}
    for edge in plan.edges:
        if edge.input in FRAMES and not NAME.fullmatch(edge.target):
            found.setdefault(edge.input, edge.origin)
    for node in plan.order():
        for output, sent in ports_of(node).outputs.items():
            origin = node if output == "out" else f"{node}.{output}"
            if output in BY_NAME and sent.message == "Frame":
                found.setdefault(output, origin)
            elif sent.message in MESSAGES:
                found[MESSAGES[sent.message]] = origin
    if not found:
        raise RunError(f"{plan.name}: expected an output that can be shown, got none")
    return found


def follow(client: GraphClient, node: str) -> str:
    """Tell the viewer what happens, until its graph or its node ends; return why, as a sentence."""
    before: Status | None = None
    crashed: set[str] = set()
    settings: dict[str, dict[str, Any]] = {}
    for look in _looks():
        try:
            now = client.status()
            lines = happened(before, now, crashed) if before is not None else []
            if look % SETTINGS_LOOKS == 0:
                lines += changed_settings(client, settings)
            told = {"lines": lines[:MOST_TOLD], "drops": drops(now, node)}
            client.command(node, "note", told)
            before = now
        except FoveaError as error:
            if not client.runs():
                return f"{client.name}: the graph has ended"
            if node not in _nodes(client):
                return f"{client.name}: the viewer was removed"
            if isinstance(error, RunError):
                continue  # it restarts, or is busy
            raise
    raise AssertionError  # looks do not end


def happened(before: Status, now: Status, crashed: set[str] | None = None) -> list[str]:
    """Return what changed between two looks, as lines: nodes, restarts, swaps, crashes.

    `crashed`: the nodes whose crash was told and whose new instance has not come yet; updated.
    """
    crashed = set() if crashed is None else crashed
    old, new = _parts(before), _parts(now)
    lines = [f"{name}: joined the graph" for name in new[0].keys() - old[0].keys()]
    lines += [f"{name}: left the graph" for name in old[0].keys() - new[0].keys()]
    for name, process in new[1].items():
        known = old[1].get(name)
        if known is not None and process.crashes > known.crashes:
            crashed.update(process.nodes)
            lines.append(f"{', '.join(process.nodes)}: its process crashed, and is restarted")
    for name, node in new[0].items():
        known_node = old[0].get(name)
        if known_node is None:
            continue
        if node.epoch > known_node.epoch:
            if name not in crashed:
                lines.append(f"{name}: swapped, instance {node.epoch} runs now")
            crashed.discard(name)
        if node.condition != known_node.condition and "stalled" in node.condition:
            lines.append(f"{name}: {node.condition}")
    return [line for line in sorted(lines) if not NAME.match(line)]


def drops(status: Status, viewer: str) -> dict[str, int]:
    """Return how many messages were dropped so far, by `EDGE/REASON`; not on the viewer's edges."""
    found: dict[str, int] = {}
    for state in status.hosts.values():
        for edge in () if isinstance(state, str) else (e for s in state for e in s.edges):
            if not edge.end.startswith(f"{viewer}."):
                for reason, count in edge.account.get("dropped", {}).items():
                    found[f"{edge.origin} to {edge.end}/{reason}"] = count
    most = sorted(found, key=lambda name: -found[name])[:MOST_TOLD]
    return {name: found[name] for name in most}


def _looks() -> Iterable[int]:
    look = 0
    while True:
        yield look
        look += 1
        time.sleep(LOOK_S)


def _parts(status: Status) -> tuple[dict[str, NodeState], dict[str, Process]]:
    states = [s for told in status.hosts.values() if not isinstance(told, str) for s in told]
    nodes = {node.name: node for state in states for node in state.nodes}
    return nodes, {process.name: process for state in states for process in state.processes}


def _nodes(client: GraphClient) -> tuple[str, ...]:
    with suppress(RunError):
        return tuple(client.status().nodes)
    return ()


def changed_settings(client: GraphClient, known: dict[str, dict[str, Any]]) -> list[str]:
    """Return which live settings changed since they were asked for last; `known` is updated."""
    lines: list[str] = []
    for node in (name for name in client.nodes() if not NAME.fullmatch(name)):
        with suppress(FoveaError):
            answer = client.configure(node, {})
            now = {name: answer.settings.get(name) for name in answer.live}
            for name, value in now.items():
                if node in known and known[node].get(name) != value:
                    lines.append(f"{node}.{name} = {json.dumps(value)}")
            known[node] = now
    return lines


def _remove(client: GraphClient, node: str) -> None:
    """Remove a node, if graph and node still exist; retry while another change is under way."""
    late_s = time.monotonic() + LEAVE_S
    while client.runs() and node in _nodes(client):  # not those that were known before it joined
        try:
            client.remove(node)
            return
        except FoveaError:
            if time.monotonic() > late_s:
                raise
            time.sleep(RETRY_S)
