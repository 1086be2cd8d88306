"""Where a running graph takes orders: one at a time, answered when it is carried out.

Orders come over the graph's bus, which only this user can reach.
"""

import logging
import os
import queue
import threading
from collections.abc import Callable

from pipeline.errors import FoveaError, RunError
from pipeline.protocol.codec import decode, encode, refused
from pipeline.protocol.orders import (
    ORDER,
    Order,
    Refused,
    Result,
    StopOrder,
    StopResult,
    SwapOrder,
)
from pipeline.protocol.supervision import Event
from pipeline.run.health import HealthMonitor
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.operation import Operation
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.process_manager import ProcessManager
from pipeline.run.swap import SwapOperation
from pipeline.run.topology import TopologyOperation
from pipeline.text import error_text

Reply = Callable[[Result], None]
log = logging.getLogger(__name__)


class ControlServer:
    """The orders of one supervisor."""

    def __init__(self, manager: ProcessManager, health: HealthMonitor) -> None:
        self._manager, self._health = manager, health
        self._asked: queue.SimpleQueue[tuple[bytes, Callable[[bytes], None]]] = queue.SimpleQueue()
        self._operation: Operation | None = None
        self._reply: Reply = _nobody
        self._lock = threading.Lock()  # between taking an order and the end of all
        self._ended = False

    def ask(self, order: bytes, reply: Callable[[bytes], None]) -> None:
        """An order came; any thread may call. After `abort` it is refused at once."""
        with self._lock:
            ended = self._ended
            if not ended:
                self._asked.put((order, reply))
        if ended:
            reply(encode(self._too_late()))
            return
        self._manager.exchange.wake()

    def tick(self) -> None:
        """Take up what was asked, carry on with what is under way."""
        while not self._asked.empty():
            order, reply = self._asked.get()
            self._take_up(order, _encoded(reply))
        if self._operation is not None:
            self._operation.tick()
            if self._operation.result is not None:
                result, done = self._operation.result, self._reply
                self._operation, self._reply = None, _nobody
                done(result)

    def take(self, order: Order, reply: Reply) -> None:
        """Begin with an order; raises `RunError` when it cannot be done."""
        manager = self._manager
        if isinstance(order, StopOrder):
            self._stop(reply)
        elif self._operation is not None:
            raise RunError(f"{manager.plan.name}: another order is under way")
        else:
            self._operation = (
                SwapOperation(manager, self._health, order)
                if isinstance(order, SwapOrder)
                else TopologyOperation(manager, order)
            )
            self._reply = reply

    def _take_up(self, order: bytes, reply: Reply) -> None:
        try:
            self.take(decode(ORDER, order), reply)
        except FoveaError as error:
            reply(refused(str(error)))
        except Exception as error:  # an order must not end the graph
            log.exception("an order broke")
            reply(refused(f"it broke: {error_text(error)}"))

    def _stop(self, reply: Reply) -> None:
        """Have the run end: its caller sees `stop_orders` rise."""
        plan = self._manager.plan
        if plan.here:
            how = f"`fovea stop {plan.name}` ends it where it was brought up"
            raise RunError(f"{plan.name}: was deployed; {how}")
        self._manager.stop_orders += 1
        reply(StopResult(graph=plan.name, pid=os.getpid()))

    def on_event(self, pid: int, event: Event) -> bool:
        """Whether an event of a process concerns the order under way alone."""
        return self._operation is not None and self._operation.on_event(pid, event)

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether the order under way looks after a process."""
        return self._operation is not None and self._operation.owns(managed)

    def abort(self) -> list[ProcessHandle]:
        """The run ends; the processes that it would not know of."""
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


def _encoded(reply: Callable[[bytes], None]) -> Reply:
    return lambda result: reply(encode(result))


def _nobody(_result: Result) -> None:
    pass
