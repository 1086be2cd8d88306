"""Changes which nodes and edges a running graph has, while the others go on.

Nodes that stay and whose edges change are told between two calls of their handlers; nobody is
started anew but what is added.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import msgspec
from pydantic import ValidationError

from pipeline.errors import RunError
from pipeline.graph.plan import Edge, Node, Plan, sources
from pipeline.graph.ports import check_ports
from pipeline.once import adapter
from pipeline.run.affair import Affair, log
from pipeline.run.child import Child
from pipeline.run.crew import Crew
from pipeline.run.slot import Slot

START_S = 60.0
TELL_S = 5.0
REST_S = 1.0


class PlanOrder(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, tag="plan"):
    """The plan that shall run, made by the loader from the one of that revision."""

    plan: dict[str, Any]
    revision: int


class Topology(Affair):
    """One change of the plan."""

    kind = "topology"

    def __init__(self, crew: Crew, order: PlanOrder) -> None:
        if order.revision != crew.revision:
            raise RunError(f"{crew.plan.name}: it was changed meanwhile, try again")
        try:
            wanted = adapter(Plan).validate_python(order.plan)
        except ValidationError as error:
            raise RunError(f"not a plan: {error.errors()[0]['msg']}") from error
        same = ("name", "clock", "hosts", "here")
        if any(getattr(wanted, name) != getattr(crew.plan, name) for name in same):
            raise RunError(f"{crew.plan.name}: expected the same {', '.join(same)} as it runs with")
        self._before, self._plan = crew.plan, _numbered(crew, wanted)
        old = {n.name: n for n in crew.plan.nodes}
        new = {n.name: n for n in self._plan.nodes}
        self._added = [n for n in self._plan.nodes if n.name not in old]
        self._removed = [n for n in crew.plan.nodes if n.name not in new]
        self._edges_added = [e for e in self._plan.edges if e not in crew.plan.edges]
        self._edges_removed = [e for e in crew.plan.edges if e not in self._plan.edges]
        self._check()
        self._mine: list[Slot] = []  # slots whose processes come or go
        super().__init__(crew, self._change())
        self.facts |= {
            "added": [n.name for n in self._added],
            "removed": [n.name for n in self._removed],
            "connected": [f"{e.origin} -> {e.end}" for e in self._edges_added],
            "cut": [f"{e.origin} -> {e.end}" for e in self._edges_removed],
        }

    def owns(self, slot: Slot) -> bool:
        """Whoever comes or goes is no crash."""
        return slot in self._mine

    def hear(self, pid: int, event: dict[str, Any]) -> bool:
        """That one of them fails, or makes no more frames, concerns this change alone."""
        super().hear(pid, event)
        mine = any(slot.child and slot.child.pid == pid for slot in self._mine)
        return mine and event.get("event") in ("failed", "finished")

    def _check(self) -> None:
        """What cannot be done while it runs; raises `RunError`."""
        stay = [n for n in self._before.nodes if n not in self._removed]
        for node in (*self._added, *self._removed):
            if any(n.process == node.process for n in stay):
                raise RunError(f"{node.name}: shares a process with nodes that stay")
        for node in stay:
            before, after = self._before.inputs(node.name), self._plan.inputs(node.name)
            for name in before.keys() ^ after.keys():
                raise RunError(f"{node.name}.inputs.{name}: can only be connected from the start")
        self._plan.order()
        check_ports(self._plan, self._plan.is_here)
        if not any(sources(self._plan)):
            raise RunError(f"{self._plan.name}: expected a node that makes frames, got none")

    def _change(self) -> Iterator[None]:
        crew = self.crew
        for edge in self._edges_added:
            crew.ledger.edges[edge.index].clear()
        for node in self._added:
            crew.ledger.nodes[node.index].clear()
        crew.change_plan(self._plan)
        fresh = [s for n, s in crew.slots.items() if n in {a.process for a in self._added}]
        try:
            self._mine = fresh
            for slot in fresh:
                crew.begin(slot)
                yield from self._ready(slot)
        except RunError:
            self._end(fresh)
            crew.change_plan(self._before)
            raise
        self._mine = []
        self._address()
        touched = {e.target for e in (*self._edges_added, *self._edges_removed)}
        writers = {e.source for e in (*self._edges_added, *self._edges_removed)}
        for name in (*touched, *(writers - touched)):  # who reads must know before who writes
            yield from self._tell(name)
        yield from self._remove()
        crew.note()

    def _ready(self, slot: Slot) -> Iterator[None]:
        child = slot.child
        assert child is not None
        yield from self.until(lambda: child.ready, START_S, f"{slot.name} was not ready", of=child)

    def _address(self) -> None:
        """Edges between nodes that run already: who speaks and who listens there now."""
        crew, fresh = self.crew, {n.name for n in self._added}
        for edge in self._edges_added:
            account = crew.ledger.edges[edge.index]
            if edge.source not in fresh:
                account.writer_epoch = crew.slots[self._plan.node(edge.source).process].epoch
            if edge.target not in fresh:
                other = next(e for e in self._before.edges if e.target == edge.target)
                known = crew.ledger.edges[other.index]
                account.reader_epoch, account.door = known.reader_epoch, known.door

    def _tell(self, name: str) -> Iterator[None]:
        """Have a node connect anew; one that does not answer starts again with the new plan."""
        if name in {n.name for n in (*self._added, *self._removed)}:
            return
        child = self.crew.slots[self._plan.node(name).process].child
        if child is None:
            return  # it starts with the new plan
        said = self.heard(child)
        said.pop("replanned", None)
        child.order("replan", node=name, plan=adapter(Plan).dump_python(self._plan, mode="json"))
        yield from self.until(
            lambda: said.get("replanned", {}).get("node") == name or child.ended() is not None,
            TELL_S, "", must=False,
        )  # fmt: skip
        if said.get("replanned", {}).get("node") != name:
            log.error("%s: does not connect anew; killed", name)
            child.kill()

    def _remove(self) -> Iterator[None]:
        crew = self.crew
        gone = [s for n, s in crew.slots.items() if n in {r.process for r in self._removed}]
        self._mine = gone
        for slot in gone:
            if slot.child is not None:
                slot.child.tell("stop")
        children: list[Child] = [slot.child for slot in gone if slot.child]
        yield from self.until(
            lambda: all(c.ended() is not None for c in children), TELL_S, "", must=False
        )
        self._end(gone)
        crew.change_plan(self._plan)
        accounts = {e.end: crew.ledger.edges[e.index] for e in self._edges_removed}
        dead = {n.name for n in self._removed}
        yield from self.until(
            lambda: all(
                crew.ledger.edges[e.index].in_flight == 0 or e.target in dead
                for e in self._edges_removed
            ),
            REST_S, "", must=False,
        )  # fmt: skip
        for end, account in accounts.items():
            log.info("topology: %s ends with %s", end, account.report())
            account.clear()

    def _end(self, slots: list[Slot]) -> None:
        for slot in slots:
            if slot.child is not None:
                slot.child.kill()
                self.crew.dismiss(slot.child)
                slot.child = None


def _numbered(crew: Crew, plan: Plan) -> Plan:
    """The plan with the numbers that its nodes and edges have in the ledger, or will have."""
    known_nodes = {n.name: n.index for n in crew.plan.nodes}
    known_edges = {_ends(e): e for e in crew.plan.edges}
    free_nodes = iter(set(range(len(crew.ledger.nodes))) - set(known_nodes.values()))
    free_edges = iter(set(range(len(crew.ledger.edges))) - {e.index for e in crew.plan.edges})
    try:
        nodes = [_same(crew, n) or replace(n, index=next(free_nodes)) for n in plan.nodes]
        edges = []
        for edge in plan.edges:
            before = known_edges.get(_ends(edge))
            index = before.index if before else next(free_edges)
            edges.append(replace(edge, index=index))
            if before and edges[-1] != before:
                raise RunError(f"{edge.end}: the policy of an edge cannot change while it runs")
    except StopIteration:
        raise RunError(
            f"{plan.name}: the accounts have no room for more nodes or edges; start it anew"
        ) from None
    return replace(plan, nodes=tuple(nodes), edges=tuple(edges))


def _same(crew: Crew, node: Node) -> Node | None:
    """The node as it runs, which keeps its settings whatever else is said of it."""
    return next((n for n in crew.plan.nodes if n.name == node.name), None)


def _ends(edge: Edge) -> tuple[str, str, str, str]:
    return edge.source, edge.output, edge.target, edge.input
