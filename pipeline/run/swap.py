"""Swap the operator of a running node: by a standby successor (hot), or by stop and start (cold).

`hot_swap` and `cold_swap` are the state machines; both access the graph through `swap_target`.
"""

from pipeline.errors import RunError
from pipeline.node.wiring import swappable
from pipeline.protocol.orders import SwapOrder, SwapResult
from pipeline.protocol.supervision import Event, Failed, Ready
from pipeline.run.cold_swap import ColdSwap
from pipeline.run.health import HealthMonitor
from pipeline.run.hot_swap import HotSwap
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.operation import Operation
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.process_manager import ProcessManager
from pipeline.run.swap_target import SwapTarget
from pipeline.settings import suggest
from pipeline.wording import shown_key


class SwapOperation(Operation):
    """One swap."""

    kind = "swap"

    def __init__(self, manager: ProcessManager, health: HealthMonitor, order: SwapOrder) -> None:
        super().__init__()
        names = [n.name for n in filter(manager.plan.is_here, manager.plan.nodes)]
        if order.node not in names:
            raise RunError(
                f"{manager.plan.name}: no node {shown_key(order.node)}{suggest(order.node, names)}"
            )
        node = manager.plan.node(order.node)
        self._managed = manager.processes[node.process]
        if self._managed.handle is None or not self._managed.handle.going:
            raise RunError(f"{order.node}: is not running now, try again")
        self._target = SwapTarget(manager, health, self._managed, node)
        hot = swappable(manager.plan, node) and not self._managed.sources
        self.facts |= {"node": order.node, "hot": hot}
        self.machine: HotSwap | ColdSwap = (
            HotSwap(self._target, order, self.events, self.facts)
            if hot
            else ColdSwap(self._target, order, self.events, self.facts)
        )

    def advance(self) -> bool:
        """Advance; raises `FoveaError` when the swap is refused or was rolled back."""
        return self.machine.advance()

    def done(self) -> SwapResult:
        """Return the result of the swap."""
        return SwapResult(**self.facts)

    def clear_up(self, *, failed: bool) -> None:
        """End the inactive process."""
        if (other := self.machine.other) is not None:
            self._target.dismiss(other)
            self.machine.other = None
        self.machine.give_back(failed=failed)

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether this swap handles exits of that process."""
        return self.machine.owned and managed is self._managed

    def on_event(self, pid: int, event: Event) -> bool:
        """Handle an event; return True when nothing else needs it."""
        if isinstance(self.machine, ColdSwap) and pid in self.machine.gone:
            return True
        other, working = self.machine.other, self._managed.handle
        mine = next((h for h in (other, working) if h and h.pid == pid), None)
        if mine is None:
            return False
        self.events.note(pid, event)
        if mine is other and isinstance(event, Ready):
            mine.ready, mine.load_s = True, event.load_s
        return mine is other or (self.machine.owned and isinstance(event, Failed))

    def abort(self) -> list[ProcessHandle]:
        """Abort at the end of the run; return the inactive process, to be ended as well."""
        return [self.machine.other] if self.machine.other else []
