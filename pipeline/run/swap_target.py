"""All that a swap may do to the graph: one node's processes, accounts, settings and place.

Hot and cold swaps know the supervisor's process manager and its ledger through this class alone.
"""

import logging
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.bus.ledger import EdgeAccount, NodeAccount
from pipeline.errors import RunError
from pipeline.graph.plan import Node, Plan
from pipeline.node.live import keep, kept
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.supervision import Go
from pipeline.run.health import HealthMonitor
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.process_manager import ProcessManager

log = logging.getLogger(__name__)


class Successor(NamedTuple):
    """A process that stands by."""

    handle: ProcessHandle
    epoch: int
    receiver: str  # where it receives


class SwapTarget:
    """One node of a running graph."""

    def __init__(
        self, manager: ProcessManager, health: HealthMonitor, managed: ManagedProcess, node: Node
    ) -> None:
        self._manager, self._health, self._managed, self.node = manager, health, managed, node
        self._told: dict[str, Any] = {}  # the settings that it was given while it ran

    @property
    def plan(self) -> Plan:
        """The plan that runs now."""
        return self._manager.plan

    @property
    def account(self) -> NodeAccount:
        """The node's account."""
        return self._manager.ledger.nodes[self.node.index]

    @property
    def run_ends(self) -> bool:
        """Whether no more frames are made."""
        return self._manager.finished

    @property
    def messages_wait(self) -> bool:
        """Whether something is under way to the node."""
        return any(account.in_flight for account in self._incoming())

    def working(self) -> ProcessHandle:
        """The process that works; raises `RunError` when there is none."""
        if self._managed.handle is None:
            raise RunError(f"{self.node.name}: does not run just now, try again")
        return self._managed.handle

    def is_working(self, handle: ProcessHandle) -> bool:
        """Whether that process is the one that works."""
        return self._managed.handle is handle

    def stalled(self) -> str:
        """Why the working process would have to be killed, or nothing."""
        return self._health.problem(self._managed)

    # processes

    def refresh_spare(self) -> None:
        """See that the spare process imports what is on disk now."""
        self._manager.spare.refresh()

    def spare_is_warming(self) -> bool:
        """Whether there is a spare process that has not finished its imports."""
        return self._manager.spare.warming

    def drop_spare(self) -> None:
        """End the spare process, which hangs."""
        self._manager.spare.dismiss()

    def launch_successor(self, plan: Plan) -> Successor:
        """Start a process that stands by to take the node over."""
        epoch = self._managed.promise()
        job = self._manager.job(self._managed, plan, epoch, standby=True, checked=True)
        handle = self._manager.launch(job, fresh=True)
        return Successor(handle, epoch, str(job.receiver(self.node.name, epoch)))

    def launch_trial(self, plan: Plan) -> ProcessHandle:
        """Start a process that only says whether operator and settings fit."""
        job = self._manager.job(self._managed, plan, self._managed.epoch, trial=True)
        return self._manager.launch(job, fresh=True)

    def dismiss(self, handle: ProcessHandle, within_s: float = 0.0) -> None:
        """Let a process end in that time, or be killed; nothing waits for it."""
        self._manager.dismiss(handle, within_s)

    def vacate(self) -> None:
        """No process works for the node now."""
        self._manager.vacate(self._managed)

    def start(self, plan: Plan) -> ProcessHandle:
        """Start the node's process anew, by a plan that is still to prove itself."""
        self._manager.begin(self._managed, plan=plan, checked=True)
        return self.working()

    def let_go(self) -> None:
        """Let the process that is ready begin, if it may."""
        self._manager.let_go(self._managed)

    def retry_soon(self) -> None:
        """Leave a node without a process to the process manager, which starts it again."""
        if self._managed.handle is None and not self._managed.next_start_s:
            self._managed.next_start_s = time.monotonic()

    # accounts

    def send_also_to(self, epoch: int) -> None:
        """Have writers send to a successor too; 0: to none."""
        for account in self._incoming():
            account.next_receiver_epoch = epoch

    def sent(self) -> list[int]:
        """How far each edge out of the node is, for `arrived`."""
        return [account.sent for account in self._outgoing()]

    def arrived(self, sent: Sequence[int]) -> bool:
        """Whether readers that live have seen all that was sent then."""
        pairs = zip(self._outgoing(), sent, strict=True)
        return not any(account.live and account.seen < count for account, count in pairs)

    def fence(self, epoch: int) -> None:
        """Refuse what other instances than that one still send."""
        for account in self._outgoing():
            account.writer_epoch = epoch

    # the change of instances

    def switch(self, successor: Successor, plan: Plan) -> None:
        """Have the successor work, by its plan; its predecessor's settings go with it."""
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
        """Have the predecessor work again, as before; its new epoch."""
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
        """Note whose reading counts on the edges into the node."""
        for account in self._incoming():
            account.reader_epoch = epoch

    def change_plan(self, plan: Plan) -> None:
        """Another plan runs now."""
        self._manager.change_plan(plan)

    # settings

    def changed(self, order: SwapOrder) -> Plan:
        """The plan with the new operator and settings in the old place."""
        node, plan = self.node, self._manager.plan
        self._told = kept(self._live_file())
        settings = {} if order.defaults else {**node.settings, **self._told}
        fresh = replace(
            node, operator=order.operator or node.operator, settings={**settings, **order.changes}
        )
        return replace(plan, nodes=tuple(fresh if n.name == node.name else n for n in plan.nodes))

    def told_since(self) -> bool:
        """Whether a live setting was changed since `changed`."""
        return kept(self._live_file()) != self._told

    def keep_settings(self) -> None:
        """Should the predecessor end, it comes back with what it had been told until `changed`."""
        try:
            if self._told:
                keep(self._live_file(), self._told)
            else:
                self.forget_settings()
        except OSError as error:
            log.warning("%s: its settings cannot be kept: %s", self.node.name, error)

    def forget_settings(self) -> None:
        """What was told is a part of the plan now."""
        self._live_file().unlink(missing_ok=True)

    def _live_file(self) -> Path:
        return self._manager.live_file(self.node.name)

    def _incoming(self) -> list[EdgeAccount]:
        return self._manager.accounts(self._managed)

    def _outgoing(self) -> list[EdgeAccount]:
        return self._manager.accounts(self._managed, outgoing=True)
