"""Client of a graph on several hosts: every request goes through their agents."""

import logging
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import msgspec

from pipeline.client.advising import take_advice
from pipeline.client.deployed_plan import changed, merged
from pipeline.client.graph_client import (
    ORDER_S,
    Edit,
    GraphClient,
    Listener,
    Status,
    Stopped,
)
from pipeline.client.local import judged, of_kind
from pipeline.client.relayed import RelayedTap
from pipeline.errors import FoveaError, RunError, SettingsError, Silent
from pipeline.fleet.deploy import Fleet, carried, down, portable, send_weights
from pipeline.fleet.hosted_graph import ends_of
from pipeline.fleet.hosts import Hosts
from pipeline.fleet.remembered import remember, remembered
from pipeline.graph.editing import loaded_ports
from pipeline.graph.plan import Plan
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import decode, decode_answer
from pipeline.protocol.orders import RESULT, SwapOrder, SwapResult, TopologyResult
from pipeline.protocol.questions import (
    ConfigQuestion,
    Health,
    HealthQuestion,
    NodeQuestion,
    NodeSettings,
)

ASK_S = 8.0  # the node's own timeout plus transport
AT_ONCE = 4  # nodes asked at once; one that hangs must not delay the others
FOLLOW_S = 0.5  # interval between reads of a log
FOLLOWED = 1000  # lines of a log read each time
log = logging.getLogger(__name__)


class DeployedGraph(GraphClient):
    """A graph that was deployed from, or attached to, this host."""

    def __init__(self, name: str, hosts: Hosts) -> None:
        self.name, self.hosts = name, hosts

    def runs(self) -> bool:
        """Whether the graph is still deployed, as far as this host knows."""
        return self.name in remembered()

    def nodes(self) -> tuple[str, ...]:
        """The names of the nodes on all hosts."""
        return tuple(self.hosts.nodes)

    def ask(self, node: str, question: NodeQuestion) -> bytes:
        """Return a node's reply; raises `FoveaError` for an unknown node or a timeout."""
        with self._way(node) as (fleet, label):
            return self._ask(fleet, label, node, question)

    def configure(self, node: str, changes: Mapping[str, Any]) -> NodeSettings:
        """Change live settings; files are sent as by `fovea up`.

        Settings that are not live are refused before any file is sent.
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
        """Return every node's health; None where the node or its host does not answer."""
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
        """Return the status that `ps` and `top` show."""
        with self.watching() as look:
            return look()

    @contextmanager
    def watching(self) -> Iterator[Callable[[], Status]]:
        """Yield a function that returns the current status, over one session."""
        with Fleet(self.hosts) as fleet:
            yield lambda: Status(
                graph=self.name,
                hosts=dict(fleet.states(self.name)),
                nodes=dict(self.hosts.nodes),
            )

    def swap(self, order: SwapOrder) -> SwapResult:
        """Replace a node; files are sent as by `fovea up`."""
        with self._way(order.node) as (fleet, label):
            self._take_advice(fleet, order)
            changes, files = carried(order.changes)
            send_files(fleet, label, files)
            order = msgspec.structs.replace(order, changes=changes)
            asked = wire.Change(self.name, order)
            said = fleet.ask(label, "swap", asked, wire.Relayed, ORDER_S)
            return of_kind(SwapResult, judged(decode(RESULT, said.payload)))

    def replan(self, edit: Edit) -> TopologyResult:
        """Apply an edit to the plan, host by host; undo it everywhere if one host fails.

        Raises `FoveaError`, also for a change of an edge between hosts.
        """
        with Fleet(self.hosts) as fleet:
            plans, revisions = self._plans(fleet)
            whole = merged(plans)
            wanted, files = portable(edit(whole))
            parts = changed(whole, wanted, plans)
            if not parts:
                raise RunError(f"{self.name}: that changes nothing")
            begun: list[str] = []
            done: dict[str, TopologyResult] = {}
            try:
                for label, plan in parts.items():
                    send_files(fleet, label, files)
                    begun.append(label)  # a host that does not answer may have changed, too
                    done[label] = self._change(fleet, label, plans[label], plan, revisions[label])
            except BaseException:
                self._take_back(fleet, {label: plans[label] for label in begun})
                raise
        nodes = {node.name: node.host for node in wanted.nodes}
        self.hosts = replace(self.hosts, nodes=nodes)
        remember(self.name, self.hosts)
        kinds = ("added", "removed", "connected", "cut")
        return TopologyResult(
            **{kind: [one for told in done.values() for one in getattr(told, kind)]
               for kind in kinds}
        )  # fmt: skip

    def stop(self) -> Stopped:
        """Stop the graph on all hosts and wait; raises `RunError` for hosts that do not answer."""
        if missing := down(self.name, self.hosts):
            raise RunError("; ".join(missing))
        return Stopped(graph=self.name)

    def logs(self, node: str, lines: int, *, follow: bool = False) -> Iterator[str]:
        """Yield the last lines of a node's log, then new ones if `follow`."""
        with self._log_way(node) as (fleet, label):
            told = self._log(fleet, label, wire.Lines(self.name, node, lines))
            yield from told.lines
            while follow:
                time.sleep(FOLLOW_S)
                told = self._log(fleet, label, wire.Lines(self.name, node, FOLLOWED, told.end))
                yield from told.lines

    def listen(self, output: str) -> Listener:
        """Return a tap on `node` or `node.output`; raises `RunError` for an unknown output."""
        return RelayedTap(self, self.hosts, output)

    def _take_advice(self, fleet: Fleet, order: SwapOrder) -> None:
        """Log what the operator says beside what runs on all hosts, if they answer within 5 s.

        It refuses nothing: the settings that a host's own file gives its nodes are not known here.
        """
        try:
            plans, _ = self._plans(fleet)
            take_advice(replace(merged(plans), here=""), order)
        except SettingsError as error:
            log.warning("%s", error)
        except FoveaError:
            return

    def _plans(self, fleet: Fleet) -> tuple[dict[str, Plan], dict[str, int]]:
        """Return the plan that every host runs, and its revision there."""
        told = fleet.each(lambda label: self._planned(fleet, label))
        plans = {label: one.plan for label, one in told.items()}
        return plans, {label: one.revision for label, one in told.items()}

    def _planned(self, fleet: Fleet, label: str) -> wire.Planned:
        return fleet.ask(label, "plan", wire.Named(self.name), wire.Planned)

    def _change(
        self, fleet: Fleet, label: str, before: Plan, plan: Plan, revision: int
    ) -> TopologyResult:
        had = {ends_of(edge) for edge in before.edges}
        running = {node.name for node in before.nodes}
        fingerprints = {}
        for edge in plan.edges:
            if ends_of(edge) not in had:
                ports = self.ports if edge.source in running else loaded_ports(plan)
                sent = ports(edge.source).outputs[edge.output]
                fingerprints[edge.origin] = sent.fingerprint
        asked = wire.PlanChange(self.name, plan, wire.Versions.ours(), fingerprints, revision)
        said = fleet.ask(label, "replan", asked, wire.Relayed, ORDER_S)
        return of_kind(TopologyResult, judged(decode(RESULT, said.payload)))

    def _take_back(self, fleet: Fleet, plans: Mapping[str, Plan]) -> None:
        """Roll hosts back to their former plans, as far as they answer."""
        for label, plan in plans.items():
            try:
                now = self._planned(fleet, label)
                if now.plan != plan:
                    self._change(fleet, label, now.plan, plan, now.revision)
            except FoveaError as error:
                log.error("%s: could not be taken back: %s", label, error)

    def _ask(self, fleet: Fleet, label: str, node: str, question: NodeQuestion) -> bytes:
        asked = wire.ToNode(self.name, node, question)
        return fleet.ask(label, "node", asked, wire.Relayed, ASK_S).payload

    def _log(self, fleet: Fleet, label: str, asked: wire.Lines) -> wire.Log:
        return fleet.ask(label, "log", asked, wire.Log)

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
    """Send a host those of the files that it accepts and lacks."""
    lacking = fleet.ask(label, "lacks", wire.Lacks(tuple(files)), wire.Missing).digests
    send_weights(fleet, label, lacking, files)
