"""Where a running graph takes orders: one at a time, answered when it is carried out.

Orders come as JSON over the graph's bus, which only this user can reach.
"""

import logging
import queue
from collections.abc import Callable
from typing import Any

import msgspec

from pipeline import codec
from pipeline.errors import FoveaError
from pipeline.run.managed_process import ManagedProcess
from pipeline.run.operation import Operation
from pipeline.run.process_handle import ProcessHandle
from pipeline.run.process_manager import ProcessManager
from pipeline.run.swap import SwapOperation, SwapOrder
from pipeline.run.topology import PlanOrder, TopologyOperation
from pipeline.text import error_text, harmless

COMMAND = "@graph"  # the key below a graph's own that takes orders
Reply = Callable[[bytes], None]
Order = SwapOrder | PlanOrder
_ORDER = msgspec.json.Decoder(Order)
log = logging.getLogger(__name__)


class ControlServer:
    """The orders of one supervisor."""

    def __init__(self, manager: ProcessManager) -> None:
        self._manager = manager
        self._asked: queue.SimpleQueue[tuple[bytes, Reply]] = queue.SimpleQueue()
        self._operation: Operation | None = None
        self._reply: Reply = _nobody

    def ask(self, order: bytes, reply: Reply) -> None:
        """An order came; called by the transport's thread."""
        self._asked.put((order, reply))
        self._manager.exchange.wake()

    def tick(self) -> None:
        """Take up what was asked, carry on with what is under way."""
        while not self._asked.empty():
            order, reply = self._asked.get()
            try:
                self.take(codec.parse(_ORDER.decode, order, "not an order"), reply)
            except FoveaError as error:
                reply(answer({"refused": str(error)}))
            except Exception as error:  # an order must not end the graph
                log.exception("an order broke")
                reply(answer({"refused": f"it broke: {harmless(error_text(error))}"}))
        if self._operation is not None:
            self._operation.tick()
            if self._operation.result is not None:
                result, reply = self._operation.result, self._reply
                self._operation, self._reply = None, _nobody
                reply(answer(result))

    def take(self, order: Order, reply: Reply) -> None:
        """Begin with an order; raises `RunError` when it cannot be done."""
        if self._operation is not None:
            reply(answer({"refused": f"{self._manager.plan.name}: another order is under way"}))
            return
        if isinstance(order, SwapOrder):
            self._operation = SwapOperation(self._manager, order)
        else:
            self._operation = TopologyOperation(self._manager, order)
        self._reply = reply

    def on_event(self, pid: int, event: dict[str, Any]) -> bool:
        """Whether an event of a process concerns the order under way alone."""
        return self._operation is not None and self._operation.on_event(pid, event)

    def owns(self, managed: ManagedProcess) -> bool:
        """Whether the order under way looks after a process."""
        return self._operation is not None and self._operation.owns(managed)

    def abort(self) -> list[ProcessHandle]:
        """The run ends; the processes that it would not know of."""
        ended = answer(
            {"refused": f"{self._manager.plan.name}: the run ended before that was done"}
        )
        while not self._asked.empty():
            self._asked.get()[1](ended)
        left = self._operation.abort() if self._operation is not None else []
        self._reply(ended)
        self._operation, self._reply = None, _nobody
        return left


def answer(result: dict[str, Any]) -> bytes:
    """A result as it travels."""
    return msgspec.json.encode(result)


def _nobody(_answer: bytes) -> None:
    pass
