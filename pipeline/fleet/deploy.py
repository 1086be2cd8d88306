"""`fovea up` and `fovea down`: deploy a graph to the agents of its hosts, all or nothing.

First every agent confirms that it may run its part; only then anything starts. A file named by a
setting is sent as its checksum; a host that lacks the file receives it if its allow list has it.
"""

import getpass
import logging
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from pipeline.bus.network import Network
from pipeline.bus.session import Session
from pipeline.errors import FoveaError, GraphError, RunError, Silent
from pipeline.fleet.hosted_graph import END_S
from pipeline.fleet.hosts import Hosts
from pipeline.fleet.inspection import INSPECT_S
from pipeline.fleet.links import asker_permits
from pipeline.fleet.names import agent_key, connected, is_routed, region_of
from pipeline.fleet.placement import (
    DIGEST_PREFIX,
    MOST_WEIGHTS_BYTES,
    check_labels,
    file_digest,
    is_path,
    partners,
)
from pipeline.fleet.remembered import forget, remember, remembered
from pipeline.graph.plan import Plan
from pipeline.graph.ports import fingerprints
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import ControlMessage, decode_answer, encode

AT_ONCE = 16  # hosts asked at once; one that is silent must not delay the others
TIMEOUT_S = 5.0  # time for an agent to answer
DOWN_S = END_S + INSPECT_S + 5.0  # the agent may be inspecting another graph
READY_S = 90.0
T = TypeVar("T")
log = logging.getLogger(__name__)


class Fleet:
    """The agents of some hosts. Use it as a context."""

    def __init__(self, hosts: Hosts) -> None:
        self.hosts = hosts
        self._identity = hosts.identity
        points = hosts.points
        self._session = Session.across(
            Network(
                connect=tuple(dict.fromkeys(map(connected, points.values()))),
                credentials=hosts.credentials,
                permits=asker_permits(self._identity, points),
                region=region_of(self._identity) if any(map(is_routed, points.values())) else "",
            )
        )

    def __enter__(self) -> "Fleet":
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def ask(
        self, label: str, verb: str, question: ControlMessage | bytes, answer: type[T],
        timeout_s: float = TIMEOUT_S,
    ) -> T:  # fmt: skip
        """Return an agent's reply; raises `RunError` for a refusal, `Silent` for a timeout."""
        data = question if isinstance(question, bytes) else encode(question)
        found = self._session.ask(agent_key(label, self._identity, verb), data, timeout_s)
        if found is None:
            point = self.hosts.points[label]
            router = f"through the router at {connected(point)}" if is_routed(point) else ""
            raise Silent(
                f"{label}: no agent answers {router or f'at {point}'} within {timeout_s:.0f} s; "
                f"{'one of them' if router else 'it'} does not run, or {self._identity} may not "
                "ask it"
            )
        return decode_answer(answer, found, label)

    def states(self, graph: str = "", timeout_s: float = 1.5) -> dict[str, list[wire.State] | str]:
        """Return the states on every host, or why they are unknown."""

        def state(label: str) -> list[wire.State] | str:
            try:
                question = wire.Named(graph)
                return list(self.ask(label, "state", question, wire.States, timeout_s).states)
            except FoveaError as error:
                return str(error)

        return self.each(state)

    def each(self, act: Callable[[str], T], labels: Iterable[str] | None = None) -> dict[str, T]:
        """Do something for several hosts at once, by default all; raises the first failure.

        It returns when all are done, also after a failure.
        """
        chosen = list(self.hosts.points if labels is None else labels)
        with ThreadPoolExecutor(AT_ONCE, thread_name_prefix="fleet") as pool:
            return dict(zip(chosen, pool.map(act, chosen), strict=True))


def up(fleet: Fleet, plan: Plan, *, again: bool = False) -> None:
    """Start a plan on its hosts and wait until it works; on failure, undo it and raise."""
    check_labels(plan, fleet.hosts.points)
    used = sorted({node.host for node in plan.nodes})
    plan, files = portable(plan)
    schemas = fingerprints(plan)
    question = wire.Prepare(plan, wire.Versions.ours(), schemas, again)
    fleet.each(lambda label: fleet.ask(label, "about", wire.Nothing(), wire.About), used)
    prepared = fleet.each(lambda label: _prepare(fleet, label, question, files), used)
    endpoints = {name: point for said in prepared.values() for name, point in said.items()}
    points = {label: fleet.hosts.points[label] for label in used}
    before = remembered().get(plan.name)
    new = Hosts(points, fleet.hosts.credentials, {n.name: n.host for n in plan.nodes})
    former = {} if before is None else before.points
    # with the former hosts until their graph is stopped: this process may be killed before
    remember(plan.name, replace(new, points={**former, **points}))
    started: list[str] = []
    concerned = partners(plan)

    def start(label: str) -> None:
        others = {other: points[other] for other in concerned[label]}
        started.append(label)
        order = wire.Start(plan, wire.Versions.ours(), schemas, endpoints, others)
        fleet.ask(label, "start", order, wire.Accepted, READY_S)

    try:
        fleet.each(start, used)
        _await(fleet, plan.name, used)
    except BaseException:  # also Ctrl-C
        _undo(fleet, plan.name, new, before, started)
        raise
    if before is not None:
        remember(plan.name, replace(new, points={**_leave(plan.name, before, used), **points}))


def _undo(
    fleet: Fleet, graph: str, new: Hosts, before: Hosts | None, started: Iterable[str]
) -> None:
    """Stop a graph where it was started; remember the hosts on which one of its name may run."""
    said = fleet.each(lambda label: _down(fleet, label, graph), started)
    left = {label: why for label, why in said.items() if why}
    for why in left.values():
        log.error("%s may still run: %s", graph, why)
    old = _without(before, said) if before is not None else Hosts({})
    if old.points:
        log.warning("%s of before still runs on %s", graph, ", ".join(old.points))
    new = _without(new, new.points.keys() - left)
    if not (old.points or new.points):
        forget(graph)
        return
    both = replace(old if old.points else new, points={**old.points, **new.points})
    remember(graph, replace(both, nodes={**old.nodes, **new.nodes}))


def _without(hosts: Hosts, labels: Collection[str]) -> Hosts:
    """Return hosts without some of them and the nodes there."""
    points = {label: point for label, point in hosts.points.items() if label not in labels}
    nodes = {node: label for node, label in hosts.nodes.items() if label in points}
    return replace(hosts, points=points, nodes=nodes)


def _leave(graph: str, before: Hosts, used: Collection[str]) -> dict[str, str]:
    """Stop a former graph of that name on hosts that the new one does not use.

    Returns the end points of hosts on which it may still run.
    """
    left: dict[str, str] = {}
    former = _without(before, used)
    if not former.points:
        return left
    with Fleet(former) as fleet:
        for label, point in former.points.items():
            if why := _down(fleet, label, graph):
                log.error("%s of before may still run: %s", graph, why)
                left[label] = point
    return left


def attach(graph: str, fleet: Fleet) -> list[str]:
    """Remember a graph deployed elsewhere and return its hosts; raises `RunError` for none."""
    states = fleet.states(graph)
    found = {label: said[0] for label, said in states.items() if said and isinstance(said, list)}
    if not found:
        raise RunError(f"{graph}: does not run on {', '.join(states)}")
    points = {label: fleet.hosts.points[label] for label in found}
    nodes = {node.name: label for label, state in found.items() for node in state.nodes}
    remember(graph, Hosts(points, fleet.hosts.credentials, nodes))
    return sorted(found)


def down(graph: str, hosts: Hosts) -> list[str]:
    """Stop a graph on all its hosts; return a sentence per host that was not reached."""
    with Fleet(hosts) as fleet:
        said = fleet.each(lambda label: _down(fleet, label, graph))
    missing = list(filter(None, said.values()))
    if not missing:
        forget(graph)
    return missing


def portable(plan: Plan) -> tuple[Plan, dict[str, Path]]:
    """Return the plan with checksums instead of files, and the files by checksum."""
    files: dict[str, Path] = {}
    nodes = []
    for node in plan.nodes:
        settings, found = carried(node.settings)
        nodes.append(replace(node, settings=settings))
        files.update(found)
    return replace(plan, nodes=tuple(nodes)), files


def carried(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Path]]:
    """Return settings with checksums instead of files, and the files by checksum."""
    files: dict[str, Path] = {}

    def marked(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {k: marked(v) for k, v in value.items()}
        if isinstance(value, (list, tuple)):
            return [marked(v) for v in value]
        if isinstance(value, str) and is_path(value) and Path(value).is_file():
            digest = file_digest(Path(value))
            files[digest] = Path(value)
            return DIGEST_PREFIX + digest
        return value

    return {name: marked(value) for name, value in values.items()}, files


def send_weights(
    fleet: Fleet, label: str, digests: Iterable[str], files: Mapping[str, Path]
) -> None:
    """Send a host weights that it allows and lacks; raises `GraphError` if one cannot be sent."""
    for digest in digests:
        if digest not in files:
            raise GraphError(f"{label}: weights {digest[:12]}… are neither there nor here")
        if (size := files[digest].stat().st_size) > MOST_WEIGHTS_BYTES:
            raise GraphError(
                f"{label}: {files[digest]}: expected up to {MOST_WEIGHTS_BYTES >> 20} MiB of "
                f"weights to send, got {size >> 20}; copy the file there and name it in agent.yaml"
            )
        fleet.ask(label, "weights", files[digest].read_bytes(), wire.Accepted, READY_S)


def default_user() -> str:
    """Return the name of this user."""
    return getpass.getuser()


def _prepare(
    fleet: Fleet, label: str, question: wire.Prepare, files: Mapping[str, Path]
) -> dict[str, str]:
    prepared = fleet.ask(label, "prepare", question, wire.Prepared, READY_S)
    if prepared.weights:
        send_weights(fleet, label, prepared.weights, files)
        prepared = fleet.ask(label, "prepare", question, wire.Prepared, READY_S)
    return prepared.endpoints


def _await(fleet: Fleet, graph: str, labels: Iterable[str]) -> None:
    """Wait until a graph works on all hosts; one that is busy starting it may be silent until then.

    Raises `RunError` when it fails somewhere, and after `READY_S`.
    """
    waiting, deadline = set(labels), time.monotonic() + READY_S

    def states_of(label: str) -> tuple[wire.State, ...] | Silent:
        try:
            return fleet.ask(label, "state", wire.Named(graph), wire.States).states
        except Silent as silent:
            return silent

    while waiting:
        for label, states in fleet.each(states_of, sorted(waiting)).items():
            if isinstance(states, Silent):
                if time.monotonic() > deadline:
                    raise states
                continue
            if not states:
                raise RunError(f"{label}: {graph} does not run there any more")
            if states[0].phase in ("failed", "stopped"):
                raise RunError(f"{label}: {states[0].failure or graph + ' was stopped'}")
            if states[0].phase == "running":
                waiting.discard(label)
        if waiting and time.monotonic() > deadline:
            raise RunError(f"{graph}: not ready after {READY_S:.0f} s on {', '.join(waiting)}")
        time.sleep(0.1)


def _down(fleet: Fleet, label: str, graph: str) -> str:
    """Stop a graph on a host; return why it may still run there, or an empty string."""
    try:
        fleet.ask(label, "about", wire.Nothing(), wire.About)  # who is silent is known sooner
        fleet.ask(label, "down", wire.Named(graph), wire.Accepted, DOWN_S)
    except FoveaError as error:
        return str(error) if isinstance(error, Silent) or _is_on(fleet, label, graph) else ""
    return ""


def _is_on(fleet: Fleet, label: str, graph: str) -> bool:
    """Whether a host runs a graph, as far as known."""
    try:
        return graph in fleet.ask(label, "about", wire.Nothing(), wire.About).graphs
    except FoveaError:
        return True
