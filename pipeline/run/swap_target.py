"""Interface of a swap to the graph: processes, accounts, settings and plan of one node.

Hot and cold swaps access the process manager and the ledger only through this class.
"""

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.bus.ledger import EdgeAccount, NodeAccount
from pipeline.errors import RunError
from pipeline.graph.plan import Node, Plan
from pipeline.node.live import keep, kept
from pipeline.node.wiring import swappable
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.supervision import Go
from pipeline.run.health import HealthMonitor
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.process_manager import ProcessManager
from pipeline.settings import suggest
from pipeline.wording import shown_key

log = logging.getLogger(__name__)


class Successor(NamedTuple):
    """A process on standby."""

    handle: ProcessHandle
    epoch: int
    receiver: str  # its receiver's address


class SwapTarget:
    """One node of a running graph."""

    def __init__(
        self, manager: ProcessManager, health: HealthMonitor, managed: ManagedProcess, node: Node
    ) -> None:
        self._manager, self._health, self._managed, self.node = manager, health, managed, node
        self._told: dict[str, Any] = {}  # its live changes

    @classmethod
    def of(cls, manager: ProcessManager, health: HealthMonitor, name: str) -> "SwapTarget":
        """Return the target of that name; raises `RunError` when it does not run here and now."""
        plan = manager.plan
        names = [node.name for node in filter(plan.is_here, plan.nodes)]
        if name not in names:
            raise RunError(f"{plan.name}: no node {shown_key(name)}{suggest(name, names)}")
        node = plan.node(name)
        managed = manager.processes[node.process]
        if managed.handle is None or not managed.handle.going:
            raise RunError(f"{name}: is not running now, try again")
        return cls(manager, health, managed, node)

    @property
    def can_stand_by(self) -> bool:
        """Whether a successor can run beside it."""
        return swappable(self._manager.plan, self.node) and not self._managed.sources

    @property
    def plan(self) -> Plan:
        """The current plan."""
        return self._manager.plan

    @property
    def start_limit_s(self) -> float:
        """How long a new instance may take to start."""
        return self._managed.start_limit_s

    @property
    def account(self) -> NodeAccount:
        """The node's account."""
        return self._manager.ledger.nodes[self.node.index]

    @property
    def run_ends(self) -> bool:
        """Whether the run is ending."""
        return self._manager.finished

    @property
    def messages_wait(self) -> bool:
        """Whether messages are in flight to the node."""
        return any(account.in_flight for account in self._incoming())

    def working(self) -> ProcessHandle:
        """Return the active process; raises `RunError` when there is none."""
        if self._managed.handle is None:
            raise RunError(f"{self.node.name}: is not running now, try again")
        return self._managed.handle

    def is_working(self, handle: ProcessHandle) -> bool:
        """Whether that process is the active one."""
        return self._managed.handle is handle

    def works_as(self, pid: int) -> bool:
        """Whether the active process has that id."""
        return self._managed.handle is not None and self._managed.handle.pid == pid

    def runs_in(self, managed: ManagedProcess) -> bool:
        """Whether that is the process of the node."""
        return managed is self._managed

    def stalled(self) -> str:
        """Return why the active process is stalled, or an empty string."""
        return self._health.problem(self._managed)

    # processes

    def refresh_spare(self) -> None:
        """Make the spare process import the current code on disk."""
        self._manager.spare.refresh()

    def spare_is_warming(self) -> bool:
        """Whether there is a spare process that is still importing."""
        return self._manager.spare.warming

    def drop_spare(self) -> None:
        """End the spare process because it hangs."""
        self._manager.spare.dismiss()

    def launch_successor(self, plan: Plan) -> Successor:
        """Start a standby process for the node."""
        epoch = self._managed.promise()
        job = self._manager.job(self._managed, plan, epoch, standby=True, checked=True)
        handle = self._manager.launch(job, fresh=True)
        return Successor(handle, epoch, str(job.receiver(self.node.name, epoch)))

    def launch_trial(self, plan: Plan) -> ProcessHandle:
        """Start a process that only checks operator and settings."""
        job = self._manager.job(self._managed, plan, self._managed.epoch, trial=True)
        return self._manager.launch(job, fresh=True)

    def dismiss(self, handle: ProcessHandle, within_s: float = 0.0) -> None:
        """Give a process that time to end, then kill it, without waiting."""
        self._manager.dismiss(handle, within_s)

    def vacate(self) -> None:
        """Mark the node as having no process."""
        self._manager.vacate(self._managed)

    def start(self, plan: Plan) -> ProcessHandle:
        """Restart the node's process with a plan that is still on probation."""
        self._manager.begin(self._managed, plan=plan, checked=True)
        return self.working()

    def let_go(self) -> None:
        """Let the ready process begin, if its conditions are met."""
        self._manager.let_go(self._managed)

    def retry_soon(self) -> None:
        """Leave a node without a process to the process manager, which restarts it."""
        if self._managed.handle is None and not self._managed.next_start_s:
            self._managed.next_start_s = time.monotonic()

    # accounts

    def send_also_to(self, epoch: int) -> None:
        """Make writers send to a successor as well; 0: to none."""
        for account in self._incoming():
            account.next_receiver_epoch = epoch

    def sent(self) -> list[int]:
        """Return the counts sent on each edge out of the node, for `arrived`."""
        return [account.sent for account in self._outgoing()]

    def arrived(self, sent: Sequence[int]) -> bool:
        """Whether live readers have seen everything up to these counts."""
        pairs = zip(self._outgoing(), sent, strict=True)
        return not any(account.live and account.seen < count for account, count in pairs)

    def fence(self, epoch: int) -> None:
        """Fence all instances but one: readers refuse their messages."""
        for account in self._outgoing():
            account.writer_epoch = epoch

    # the change of instances

    def switch(self, successor: Successor, plan: Plan) -> None:
        """Activate the successor with its plan, which contains its predecessor's live changes."""
        managed, epoch = self._managed, successor.epoch
        for account in self._incoming():
            account.reader_epoch = epoch
            account.next_receiver_epoch, account.receiver_epoch = account.receiver_epoch, epoch
        managed.handle, managed.epoch = successor.handle, epoch
        successor.handle.going, managed.going_since_s = True, time.monotonic()
        successor.handle.tell(Go())
        self.forget_settings()
        self._manager.change_plan(plan)

    def switch_back(self, old: ProcessHandle, before: Plan) -> int:
        """Reactivate the predecessor and return its new epoch."""
        managed, switched = self._managed, not self.is_working(old)
        managed.handle = old
        if switched:
            for account in self._incoming():
                account.receiver_epoch, account.next_receiver_epoch = account.next_receiver_epoch, 0
            self._manager.change_plan(before)
            self.keep_settings()
        managed.epoch = managed.promise()
        return managed.epoch

    def read_by(self, epoch: int) -> None:
        """Set the active reader of the edges into the node."""
        for account in self._incoming():
            account.reader_epoch = epoch

    def change_plan(self, plan: Plan) -> None:
        """Switch to another plan."""
        self._manager.change_plan(plan)

    # settings

    def changed(self, order: SwapOrder) -> Plan:
        """Return the plan with the new operator and settings."""
        self._told = kept(self._live_file())
        return swapped(self._manager.plan, order, self._told)

    def told_since(self) -> bool:
        """Whether a live setting was changed since `changed`."""
        return kept(self._live_file()) != self._told

    def keep_settings(self) -> None:
        """Store the predecessor's live changes until `changed`, in case it restarts."""
        try:
            if self._told:
                keep(self._live_file(), self._told)
            else:
                self.forget_settings()
        except OSError as error:
            log.warning("%s: its settings cannot be kept: %s", self.node.name, error)

    def forget_settings(self) -> None:
        """Remove the stored live changes, which are part of the plan now."""
        self._live_file().unlink(missing_ok=True)

    def _live_file(self) -> Path:
        return self._manager.live_file(self.node.name)

    def _incoming(self) -> list[EdgeAccount]:
        return self._manager.accounts(self._managed)

    def _outgoing(self) -> list[EdgeAccount]:
        return self._manager.accounts(self._managed, outgoing=True)


def swapped(plan: Plan, order: SwapOrder, told: Mapping[str, Any]) -> Plan:
    """Return a plan with the operator and settings of an order; `told`: the live changes."""
    node = plan.node(order.node)
    settings = {} if order.defaults else {**node.settings, **told}
    fresh = replace(
        node, operator=order.operator or node.operator, settings=laid(settings, order.changes)
    )
    return replace(plan, nodes=tuple(fresh if n.name == node.name else n for n in plan.nodes))


def laid(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with changes; dots in a name lead into a mapping.

    >>> laid({"options": {"scene": "soccer", "seed": 7}}, {"options.seed": 8, "rate": 2})
    {'options': {'scene': 'soccer', 'seed': 8}, 'rate': 2}
    """
    found = dict(settings)
    for name, value in changes.items():
        *way, last = name.split(".")
        place = found
        for key in way:
            inner = place.get(key)
            inner = {} if inner is None else inner
            if not isinstance(inner, Mapping):  # the name as a whole is refused, which tells it
                place, last = found, name
                break
            place[key] = dict(inner)
            place = place[key]
        place[last] = value
    return found
