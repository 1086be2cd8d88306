"""Shadow run of a successor on the active instance's frames: outputs compared, none sent.

It starts from the active instance's state, so that equal operators give equal outputs. It copies
messages where holding them would block their writers.
"""

import queue
import time
from collections.abc import Callable, Mapping
from dataclasses import fields

import numpy as np

from pipeline.bus.envelope_buffer import EdgeCut
from pipeline.bus.inbox import Inbox, InboxPosition, Work
from pipeline.bus.outport import Arrival
from pipeline.contract import fresh_memory
from pipeline.executor import carried
from pipeline.messages import Message, altered
from pipeline.node.operator_runner import OperatorRunner
from pipeline.protocol.orders import Difference, ShadowReport

MOST_WAITING = 64  # outputs of either side without a counterpart yet

Heard = queue.SimpleQueue[tuple[str, Arrival]]  # output, the active instance's message


class Shadow:
    """Calls the handlers of a runner's operator, on the runner's thread, for some frames."""

    def __init__(
        self,
        runner: OperatorRunner,
        position: InboxPosition,
        edges: Mapping[str, EdgeCut],
        heard: Heard,
        frames: int,
    ) -> None:
        self._runner, self._heard, self._wanted = runner, heard, frames
        self._inbox = Inbox(runner.inbox.inputs, lambda *_: None, lockstep=runner.lockstep)
        self._inbox.go_on_from(position)
        self._mine: dict[tuple[str, int], Message | None] = {}
        self._theirs: dict[tuple[str, int], Message | None] = {}
        self._times_ms: list[float] = []
        self.frames = self.identical = 0
        self.differences: dict[str, Difference] = {}
        self._memory = runner.executor.allocate_from(fresh_memory)
        self._ports = [port.shadow(self._deliver(name)) for name, port in runner.ports.items()]
        for port, cut in zip(self._ports, (edges[name] for name in runner.ports), strict=True):
            port.take_over(cut)

    @property
    def done(self) -> bool:
        """Whether enough frames were compared."""
        return self.frames >= self._wanted

    def step(self) -> None:
        """Handle arrivals, and compare frames that both sides have answered."""
        while (work := self._inbox.take(time.monotonic_ns())) is not None:
            self._handle(work)
        while not self._heard.empty():
            output, arrival = self._heard.get()
            self._theirs[output, arrival.header.seq] = arrival.message
        for key in sorted(self._mine.keys() & self._theirs.keys()):
            if not self.done:
                self._compare(self._mine[key], self._theirs[key])
            del self._mine[key], self._theirs[key]
        for side in (self._mine, self._theirs):
            while len(side) > MOST_WAITING:
                del side[next(iter(side))]

    def end(self) -> ShadowReport:
        """Release everything and return the figures."""
        self._runner.executor.allocate_from(self._memory)
        for port in self._runner.ports.values():
            port.also = None
        return ShadowReport(
            missed=sum(port.dropped for port in self._ports),  # taps hold no slot
            frames=self.frames,
            identical=self.identical,
            differences=self.differences,
            handler_ms=round(float(np.median(self._times_ms)), 3) if self._times_ms else 0.0,
        )

    def _deliver(self, name: str) -> Callable[[Arrival], None]:
        return lambda arrival: self._inbox.offer(name, arrival, time.monotonic_ns())

    def _handle(self, work: Work) -> None:
        runner, begun = self._runner, time.monotonic()
        if work.new_stream:
            runner.operator.on_stream(work.header)
        answers = runner.executor.call(work.messages) if work.answer else {}
        if work.messages and runner.executor.is_side(tuple(work.messages)):
            return
        self._times_ms.append(1000 * (time.monotonic() - begun))
        for output in runner.outs:
            message = answers.get(output)
            if message is not None:
                leaving = altered(message, header=work.header)
                message = carried(leaving, f"{runner.name}.{output}")
            self._mine[output, work.header.seq] = message

    def _compare(self, mine: Message | None, theirs: Message | None) -> None:
        self.frames += 1
        found = differences(mine, theirs)
        self.identical += not found
        for name, most in found.items():
            known = self.differences.get(name, Difference(0, 0.0))
            self.differences[name] = Difference(known.frames + 1, max(known.most, most))


def differences(mine: Message | None, theirs: Message | None) -> dict[str, float]:
    """Return the fields in which two outputs differ, with the largest difference of arrays.

    Headers do not count. The key `answer` means that only one side has a message.
    """
    if mine is None or theirs is None:
        return {} if mine is theirs else {"answer": 0.0}
    found = {}
    for name in (f.name for f in fields(mine) if f.name != "header"):
        a, b = getattr(mine, name), getattr(theirs, name)
        if not isinstance(a, np.ndarray):
            if a != b:
                found[name] = 0.0
        elif a.shape != b.shape or a.dtype.kind not in "iuf":
            if not np.array_equal(a, b):
                found[name] = 0.0
        elif not np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
            apart = np.abs(a.astype(np.float64) - b.astype(np.float64))
            found[name] = float(np.nanmax(apart)) if np.isfinite(apart).any() else 0.0
    return found
