"""Execute orders to a running graph one at a time, and reply when each is done.

Orders arrive over the graph's bus, which only this user can reach.
"""

import logging
import os
import queue
import threading
from collections.abc import Callable

from pipeline.errors import Busy, FoveaError, RunError
from pipeline.protocol.codec import decode, encode, failed, refused
from pipeline.protocol.orders import (
    ORDER,
    Order,
    PlanOrder,
    Refused,
    Result,
    StopOrder,
    StopResult,
    SwapOrder,
)
from pipeline.protocol.supervision import Event
from pipeline.run.cold_swap import ColdSwap
from pipeline.run.health import HealthMonitor
from pipeline.run.hot_swap import HotSwap
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.operation import Operation
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.process_manager import ProcessManager
from pipeline.run.swap_target import SwapTarget
from pipeline.run.topology import TopologyOperation

MOST_ASKED = 16  # orders that wait
Reply = Callable[[Result], None]
log = logging.getLogger(__name__)


class ControlServer:
    """The orders of one supervisor."""

    def __init__(self, manager: ProcessManager, health: HealthMonitor) -> None:
        self._manager, self._health = manager, health
        self._asked: queue.Queue[tuple[bytes, Callable[[bytes], None]]] = queue.Queue(MOST_ASKED)
        self._operation: Operation | None = None
        self._about = ""  # what the operation is, in words
        self._reply: Reply = _nobody
        self._lock = threading.Lock()  # protects accepting an order against `abort`
        self._ended = False

    def ask(self, order: bytes, reply: Callable[[bytes], None]) -> None:
        """Queue an order, from any thread; after `abort`, or of too many, it is refused at once."""
        refusal: Refused | None = None
        with self._lock:
            if self._ended:
                refusal = self._too_late()
            else:
                try:
                    self._asked.put_nowait((order, reply))
                except queue.Full:
                    name = self._manager.plan.name
                    refusal = refused(f"{name}: {MOST_ASKED} orders are waiting", busy=True)
        if refusal is not None:
            reply(encode(refusal))
            return
        self._manager.exchange.wake()

    def tick(self) -> None:
        """Accept a queued order, and advance the current operation.

        One at a time: a large order takes long to decode, and nothing is watched meanwhile.
        """
        if not self._asked.empty():
            order, reply = self._asked.get()
            self._take_up(order, _encoded(reply))
            if not self._asked.empty():
                self._manager.exchange.wake()
        if self._operation is not None:
            self._operation.tick()
            if self._operation.result is not None:
                result, done = self._operation.result, self._reply
                self._operation, self._reply = None, _nobody
                done(result)

    def take(self, order: Order, reply: Reply) -> None:
        """Start an order; raises `RunError` when it cannot be done."""
        manager = self._manager
        if isinstance(order, StopOrder):
            self._stop(reply)
        elif self._operation is not None:
            raise Busy(f"{manager.plan.name}: another order is in progress, {self._about}")
        else:
            self._operation = self._started(order)
            self._reply, self._about = reply, about(order)

    def _started(self, order: SwapOrder | PlanOrder) -> Operation:
        if not isinstance(order, SwapOrder):
            return TopologyOperation(self._manager, order)
        target = SwapTarget.of(self._manager, self._health, order.node)
        return HotSwap(target, order) if target.can_stand_by else ColdSwap(target, order)

    def _take_up(self, order: bytes, reply: Reply) -> None:
        try:
            self.take(decode(ORDER, order), reply)
        except FoveaError as error:
            reply(refused(str(error), busy=isinstance(error, Busy)))
        except Exception as error:  # an order must not end the graph
            log.exception("an order failed")
            reply(failed(error))

    def _stop(self, reply: Reply) -> None:
        """Request the end of the run, which is signalled by `stop_orders`."""
        plan = self._manager.plan
        if plan.here:
            how = f"`fovea stop {plan.name}` ends it where it was brought up"
            raise RunError(f"{plan.name}: was deployed; {how}")
        self._manager.stop_orders += 1
        reply(StopResult(graph=plan.name, pid=os.getpid()))

    def on_event(self, pid: int, event: Event) -> bool:
        """Pass an event to the current operation; return True if it concerns only that."""
        return self._operation is not None and self._operation.on_event(pid, event)

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether the current operation handles exits of a process."""
        return self._operation is not None and self._operation.owns(managed)

    def abort(self) -> list[ProcessHandle]:
        """Abort at the end of the run; return processes that only the operation knows."""
        with self._lock:
            self._ended = True
        ended = self._too_late()
        while not self._asked.empty():
            _encoded(self._asked.get()[1])(ended)
        left = self._operation.abort() if self._operation is not None else []
        self._reply(ended)
        self._operation, self._reply = None, _nobody
        return left

    def _too_late(self) -> Refused:
        return refused(f"{self._manager.plan.name}: the run ended before that was done")


def about(order: SwapOrder | PlanOrder) -> str:
    """Return what an order changes, in words.

    >>> about(SwapOrder(node="eye", at=900))
    'a swap of eye from frame 900 on'
    """
    if not isinstance(order, SwapOrder):
        return "a change of its nodes"
    return f"a swap of {order.node}" + (f" from frame {order.at} on" if order.at else "")


def _encoded(reply: Callable[[bytes], None]) -> Reply:
    return lambda result: reply(encode(result))


def _nobody(_result: Result) -> None:
    pass
