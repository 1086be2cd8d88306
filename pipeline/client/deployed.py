"""A graph that runs on several hosts: everything asked of it goes through their agents."""

import time
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, cast

import msgspec

from pipeline.client.graph_client import (
    ORDER_S,
    Edit,
    GraphClient,
    Listener,
    Status,
    Stopped,
)
from pipeline.client.local import judged, of_kind
from pipeline.errors import FoveaError, RunError, Silent
from pipeline.fleet import wire
from pipeline.fleet.deploy import Fleet, Hosts, carried, down, remembered, send_weights
from pipeline.protocol.codec import decode, decode_answer, encode
from pipeline.protocol.orders import RESULT, SwapOrder, SwapResult, TopologyResult
from pipeline.protocol.questions import (
    KEYS,
    ConfigQuestion,
    Health,
    HealthQuestion,
    NodeQuestion,
    NodeSettings,
)

ASK_S = 8.0  # the node's own timeout, and the way
AT_ONCE = 4  # nodes; one that hangs must not hold up the others
FOLLOW_S = 0.5  # between two looks at a log
FOLLOWED = 1000  # lines of a log that are looked at each time


class DeployedGraph(GraphClient):
    """A graph that was deployed from here, or attached to."""

    def __init__(self, name: str, hosts: Hosts) -> None:
        self.name, self.hosts = name, hosts

    def runs(self) -> bool:
        """Whether it is still deployed, as far as is known here."""
        return self.name in remembered()

    def nodes(self) -> tuple[str, ...]:
        """The names of its nodes on all hosts."""
        return tuple(self.hosts.nodes)

    def ask(self, node: str, question: NodeQuestion) -> bytes:
        """One node's answer or refusal; raises `FoveaError` for no such node, or for silence."""
        with self._way(node) as (fleet, label):
            return self._ask(fleet, label, node, question)

    def configure(self, node: str, changes: Mapping[str, Any]) -> NodeSettings:
        """Change live settings; files go along as at `fovea up`.

        What is no live setting is refused before a file is sent.
        """
        with self._way(node) as (fleet, label):
            moved, files = carried(changes)
            if files:
                asked = self._ask(fleet, label, node, ConfigQuestion())
                live = decode_answer(NodeSettings, asked).live
                self._check_live(node, [n for n in changes if moved[n] != changes[n]], live)
                send_files(fleet, label, files)
            asked = self._ask(fleet, label, node, ConfigQuestion(moved))
            return decode_answer(NodeSettings, asked)

    def health(self) -> dict[str, Health | None]:
        """What every node says; None for one that is silent, or whose host is."""
        with Fleet(self.hosts) as fleet, ThreadPoolExecutor(AT_ONCE) as pool:
            states = fleet.states(self.name)
            there = {label for label, said in states.items() if not isinstance(said, str)}

            def health(node: str) -> Health | None:
                label = self.hosts.nodes[node]
                if label not in there:
                    return None
                try:
                    return decode_answer(Health, self._ask(fleet, label, node, HealthQuestion()))
                except FoveaError:
                    return None

            nodes = self.hosts.nodes
            return dict(zip(nodes, pool.map(health, nodes), strict=True))

    def status(self) -> Status:
        """What `ps` and `top` show."""
        with self.watching() as look:
            return look()

    @contextmanager
    def watching(self) -> Iterator[Callable[[], Status]]:
        """A way to look again and again, over one session."""
        with Fleet(self.hosts) as fleet:
            yield lambda: Status(
                graph=self.name,
                hosts=dict(fleet.states(self.name)),
                nodes=dict(self.hosts.nodes),
            )

    def swap(self, order: SwapOrder) -> SwapResult:
        """Replace a node; files go along as at `fovea up`."""
        with self._way(order.node) as (fleet, label):
            changes, files = carried(order.changes)
            send_files(fleet, label, files)
            order = msgspec.structs.replace(order, changes=changes)
            asked = wire.Change(self.name, order)
            said = fleet.ask(label, "swap", asked, wire.Said, ORDER_S)
            return of_kind(SwapResult, judged(decode(RESULT, said.payload)))

    def replan(self, edit: Edit) -> TopologyResult:
        """Have it become what `edit` makes of its plan; raises `FoveaError`."""
        raise RunError(
            f"{self.name}: runs on several hosts; edit its file and `fovea up --replace`"
        )

    def stop(self) -> Stopped:
        """End it on all its hosts, and wait for that; raises `RunError` for those not reached."""
        if missing := down(self.name, self.hosts):
            raise RunError("; ".join(missing))
        return Stopped(graph=self.name)

    def logs(self, node: str, lines: int, *, follow: bool = False) -> Iterator[str]:
        """The last lines of a node's log, then what is added."""
        with self._log_way(node) as (fleet, label):
            seen = self._log(fleet, label, node, FOLLOWED if follow else lines)
            yield from seen[-lines:] if lines else ()
            while follow:
                time.sleep(FOLLOW_S)
                now = self._log(fleet, label, node, FOLLOWED)
                yield from now[_overlap(seen, now) :]
                seen = now

    def listen(self, output: str) -> Listener:
        """A tap on `node` or `node.output`; raises `RunError` for an output that does not exist."""
        raise RunError(f"{self.name}: runs on several hosts; listen on the host of {output}")

    def _ask(self, fleet: Fleet, label: str, node: str, question: NodeQuestion) -> bytes:
        key = cast(wire.Question, KEYS[type(question)])
        asked = wire.ToNode(self.name, node, key, encode(question))
        return fleet.ask(label, "node", asked, wire.Said, ASK_S).payload

    def _log(self, fleet: Fleet, label: str, node: str, lines: int) -> tuple[str, ...]:
        return fleet.ask(label, "log", wire.Lines(self.name, node, lines), wire.Log).lines

    @contextmanager
    def _log_way(self, node: str) -> Iterator[tuple[Fleet, str]]:
        try:
            with self._way(node) as found:
                yield found
        except Silent as error:
            raise RunError(f"no log of a node {node}; {error}") from error

    @contextmanager
    def _way(self, node: str) -> Iterator[tuple[Fleet, str]]:
        self.check_node(node)
        with Fleet(self.hosts) as fleet:
            yield fleet, self.hosts.nodes[node]

    def _check_live(self, node: str, names: Collection[str], live: Collection[str]) -> None:
        for name in names:
            if name not in live:
                raise RunError(
                    f"{node}.{name}: cannot change while the node runs; "
                    f"`fovea swap {self.name} {node} --set {name}=…` starts another one with it"
                )


def send_files(fleet: Fleet, label: str, files: Mapping[str, Any]) -> None:
    """Give a host those of the files that it allows and lacks."""
    lacking = fleet.ask(label, "lacks", wire.Lacks(tuple(files)), tuple[str, ...])
    send_weights(fleet, label, lacking, files)


def _overlap(seen: tuple[str, ...], now: tuple[str, ...]) -> int:
    """How many of the lines now were there before: they end as the ones before do.

    >>> _overlap(("a", "b", "c"), ("b", "c", "d")), _overlap(("c",), ("a", "b", "c", "d"))
    (2, 3)
    """
    for end in range(len(now), 0, -1):
        count = min(end, len(seen))
        if count and now[end - count : end] == seen[-count:]:
            return end
    return 0
