"""Add, remove and rewire nodes of a running graph, while the others keep running.

Remaining nodes whose edges change are reconnected between two calls of their handlers; only added
nodes are started.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from pipeline.bus.ledger import ROOM_EDGES, ROOM_NODES
from pipeline.errors import Busy, RunError
from pipeline.graph.plan import Edge, Node, Plan
from pipeline.graph.ports import check_ports
from pipeline.protocol.orders import PlanOrder, TopologyResult
from pipeline.protocol.supervision import Event, Failed, Finished, Fits, Replan, Replanned, Stop
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.operation import Operation, log
from pipeline.run.process_handle import ProcessHandle, ending
from pipeline.run.process_manager import ProcessManager

TELL_S = 5.0
REST_S = 1.0
LEAVE_S = 1.0  # for the trial process to exit
DONE = object()


class TopologyOperation(Operation):
    """One change of the plan."""

    kind = "topology"

    def __init__(self, manager: ProcessManager, order: PlanOrder) -> None:
        if order.revision != manager.revision:
            raise Busy(f"{manager.plan.name}: it was changed meanwhile, try again")
        wanted = order.plan
        same = ("name", "clock", "hosts", "here")
        if any(getattr(wanted, name) != getattr(manager.plan, name) for name in same):
            raise RunError(
                f"{manager.plan.name}: expected the same {', '.join(same)} as it runs with"
            )
        self._before, self._plan = manager.plan, _numbered(manager, wanted)
        old = {n.name: n for n in manager.plan.nodes}
        new = {n.name: n for n in self._plan.nodes}
        self._added = [n for n in self._plan.nodes if n.name not in old]
        self._removed = [n for n in manager.plan.nodes if n.name not in new]
        self._edges_added = [e for e in self._plan.edges if e not in manager.plan.edges]
        self._edges_removed = [e for e in manager.plan.edges if e not in self._plan.edges]
        self._check()
        self._mine: list[ManagedProcess] = []  # added or removed processes
        self._trial: ProcessHandle | None = None  # imports added operators, instead of this process
        super().__init__()
        self.manager, self._steps = manager, self._change()
        self.facts |= {
            "added": [n.name for n in self._added],
            "removed": [n.name for n in self._removed],
            "connected": [f"{e.origin} -> {e.end}" for e in self._edges_added],
            "cut": [f"{e.origin} -> {e.end}" for e in self._edges_removed],
        }

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether a process is added or removed by this change, so that its end is no crash."""
        return managed in self._mine

    def on_event(self, pid: int, event: Event) -> bool:
        """Handle failures and ends of added or removed processes."""
        super().on_event(pid, event)
        if self._trial is not None and self._trial.pid == pid:
            return True
        mine = any(managed.handle and managed.handle.pid == pid for managed in self._mine)
        return mine and isinstance(event, (Failed, Finished))

    def advance(self) -> bool:
        """Advance by one step."""
        return next(self._steps, DONE) is DONE

    def abort(self) -> list[ProcessHandle]:
        """Abort at the end of the run; return the trial process, which has nothing to close."""
        if self._trial is None:
            return []
        self._trial.kill()
        return [self._trial]

    def clear_up(self, *, failed: bool) -> None:
        """Dismiss the trial process."""
        self._dismiss_trial()

    def done(self) -> TopologyResult:
        """Return the added and removed nodes and edges."""
        return TopologyResult(**self.facts)

    def _check(self) -> None:
        """Raise `RunError` for changes that are impossible at run time."""
        stay = [n for n in self._before.nodes if n not in self._removed]
        for node in (*self._added, *self._removed):
            if any(n.process == node.process for n in stay):
                raise RunError(f"{node.name}: shares a process with nodes that stay")
        for node in stay:
            before, after = self._before.inputs(node.name), self._plan.inputs(node.name)
            for name in before.keys() ^ after.keys():
                raise RunError(f"{node.name}.inputs.{name}: can only be connected from the start")
        self._plan.order()

    def _check_operators(self) -> Iterator[None]:
        """Check that the operators fit; a trial process imports the added ones."""
        plan, manager = self._plan, self.manager
        added = {node.name for node in self._added}
        for name, nodes in plan.processes().items():
            if added.issuperset(node.name for node in nodes):
                yield from self._try(ManagedProcess(name, nodes))
        check_ports(plan, plan.is_here, manager.ports_of)
        here = filter(plan.is_here, plan.nodes)
        if not (plan.here or any(manager.ports_of(node).source for node in here)):
            raise RunError(f"{plan.name}: expected a node that makes frames, got none")

    def _try(self, managed: ManagedProcess) -> Iterator[None]:
        job = self.manager.job(managed, self._plan, managed.promise(), trial=True)
        trial = self._trial = self.manager.launch(job, fresh=True)
        names = ", ".join(node.operator for node in managed.nodes)
        limit_s = managed.start_limit_s
        late_s = time.monotonic() + limit_s
        while not self.events.heard(trial, Fits):
            if self.events.over(trial):
                failed, status = self.events.heard(trial, Failed), trial.ended() or 0
                how = f"{managed.name}: the process that imported {names} ended by {ending(status)}"
                raise RunError(failed.error if failed else how)
            if time.monotonic() > late_s:
                limit = f"within {limit_s:.0f} s"
                raise RunError(f"{managed.name}: {names} was not imported and checked {limit}")
            yield
        self._dismiss_trial(LEAVE_S)

    def _dismiss_trial(self, within_s: float = 0.0) -> None:
        if self._trial is not None:
            self.manager.dismiss(self._trial, within_s)
            self._trial = None

    def _change(self) -> Iterator[None]:
        manager = self.manager
        yield from self._check_operators()
        for edge in self._edges_added:
            manager.ledger.edges[edge.index].clear()
        for node in self._added:
            manager.ledger.nodes[node.index].clear()
            # an earlier node of that name may have been told other settings while it ran
            manager.live_file(node.name).unlink(missing_ok=True)
        manager.change_plan(self._plan)
        fresh = [s for n, s in manager.processes.items() if n in {a.process for a in self._added}]
        try:
            self._mine = fresh
            for managed in fresh:
                manager.begin(managed)
                manager.note()  # with its process, which may take long to get ready
                yield from self._ready(managed)
        except RunError:
            self._end(fresh)
            manager.change_plan(self._before)
            raise
        self._mine = []
        self._address()
        touched = {e.target for e in (*self._edges_added, *self._edges_removed)}
        writers = {e.source for e in (*self._edges_added, *self._edges_removed)}
        for name in (*touched, *(writers - touched)):  # readers before writers
            yield from self._tell(name)
        yield from self._remove()
        manager.note()

    def _ready(self, managed: ManagedProcess) -> Iterator[None]:
        handle, limit_s = managed.handle, managed.start_limit_s
        late_s = time.monotonic() + limit_s
        assert handle is not None
        while not handle.ready:
            self.events.check_alive(handle)
            if time.monotonic() > late_s:
                raise RunError(f"topology: {managed.name} was not ready within {limit_s:.0f} s")
            yield

    def _address(self) -> None:
        """Set the active instances of new edges between running nodes."""
        manager, fresh = self.manager, {n.name for n in self._added}
        for edge in self._edges_added:
            account = manager.ledger.edges[edge.index]
            if edge.source not in fresh:
                account.writer_epoch = manager.processes[self._plan.node(edge.source).process].epoch
            if edge.target not in fresh:
                other = next(e for e in self._before.edges if e.target == edge.target)
                known = manager.ledger.edges[other.index]
                account.reader_epoch, account.receiver_epoch = (
                    known.reader_epoch,
                    known.receiver_epoch,
                )

    def _tell(self, name: str) -> Iterator[None]:
        """Make a node reconnect; if it does not answer, it is restarted with the new plan."""
        if name in {n.name for n in (*self._added, *self._removed)}:
            return
        handle = self.manager.processes[self._plan.node(name).process].handle
        if handle is None:
            return  # it starts with the new plan

        def replanned() -> bool:
            return self.events.heard(handle, Replanned) == Replanned(name)

        self.events.forget(handle, Replanned)
        handle.tell(Replan(name, self._plan))
        yield from _until(lambda: replanned() or handle.ended() is not None, TELL_S)
        if not replanned():
            log.error("%s: does not reconnect; killed", name)
            handle.kill()

    def _remove(self) -> Iterator[None]:
        manager = self.manager
        gone = [s for n, s in manager.processes.items() if n in {r.process for r in self._removed}]
        self._mine = gone
        for managed in gone:
            if managed.handle is not None:
                managed.handle.tell(Stop())
        handles: list[ProcessHandle] = [managed.handle for managed in gone if managed.handle]
        yield from _until(lambda: all(c.ended() is not None for c in handles), TELL_S)
        self._end(gone)
        manager.change_plan(self._plan)
        accounts = {e.end: manager.ledger.edges[e.index] for e in self._edges_removed}
        dead = {n.name for n in self._removed}
        yield from _until(
            lambda: all(
                manager.ledger.edges[e.index].in_flight == 0 or e.target in dead
                for e in self._edges_removed
            ),
            REST_S,
        )
        for end, account in accounts.items():
            log.info("topology: %s ends with %s", end, account.report())
            account.clear()

    def _end(self, processes: list[ManagedProcess]) -> None:
        for managed in processes:
            if managed.handle is not None:
                managed.handle.kill()
                self.manager.dismiss(managed.handle)
                managed.handle = None


def _until(done: Callable[[], bool], limit_s: float) -> Iterator[None]:
    """Wait for a condition, up to a limit."""
    late_s = time.monotonic() + limit_s
    while not done() and time.monotonic() <= late_s:
        yield


def _numbered(manager: ProcessManager, plan: Plan) -> Plan:
    """Return the plan with the indices of its nodes and edges in the ledger."""
    known_nodes = {n.name: n.index for n in manager.plan.nodes}
    known_edges = {_ends(e): e for e in manager.plan.edges}
    free_nodes = iter(set(range(len(manager.ledger.nodes))) - set(known_nodes.values()))
    free_edges = iter(set(range(len(manager.ledger.edges))) - {e.index for e in manager.plan.edges})
    try:
        nodes = [_same(manager, n) or replace(n, index=next(free_nodes)) for n in plan.nodes]
        edges = []
        for edge in plan.edges:
            before = known_edges.get(_ends(edge))
            index = before.index if before else next(free_edges)
            edges.append(replace(edge, index=index))
            if before and edges[-1] != before:
                raise RunError(f"{edge.end}: the policy of an edge cannot change while it runs")
    except StopIteration:
        raise RunError(
            f"{plan.name}: expected at most {ROOM_NODES} nodes and {ROOM_EDGES} edges more than it "
            "started with, got more; what joined it must leave, or the graph be started with it"
        ) from None
    return replace(plan, nodes=tuple(nodes), edges=tuple(edges))


def _same(manager: ProcessManager, node: Node) -> Node | None:
    """Return the running node if it stays, with its current settings."""
    return next((n for n in manager.plan.nodes if n.name == node.name), None)


def _ends(edge: Edge) -> tuple[str, str, str, str]:
    return edge.source, edge.output, edge.target, edge.input
