"""Run one operator: arrivals to handler calls, outputs to ports, progress to the ledger.

It is the same for a process with one node and for a group. The transport's threads only deliver;
the runner's own thread calls the operator.
"""

import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from queue import SimpleQueue
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.bus.clocks import Clocks
from pipeline.bus.inbox import Inbox, Work
from pipeline.bus.inport import InPort
from pipeline.bus.ledger import EdgeAccount, NodeAccount
from pipeline.bus.local_transport import LocalReceiver
from pipeline.bus.outport import Arrival, OutPort
from pipeline.contract import Input, Operator
from pipeline.errors import MessageError, PoolExhausted
from pipeline.executor import Answers, Executor
from pipeline.messages import Header, Span, altered, stamped
from pipeline.node.scheduling_delay import SchedulingDelay

IDLE_S = 0.2  # heartbeat interval of an idle runner
HANDSHAKE_S = 0.02  # interval while a reader has not received a handshake
CREDIT_S = 0.0005
MOST_ASKED = 64  # questions queued until a handler returns
DELAY_EVERY = 8  # exposures per read of the kernel's scheduling statistics, which takes time


class Standby(Protocol):
    """Keeps a runner inactive while another instance is active (`handover`)."""

    inactive: bool

    def stand_by(self, receiver: LocalReceiver) -> None:
        """Wait for a moment while inactive."""
        ...

    def poll(self) -> None:
        """Check whether to stop."""
        ...


class OperatorRunner:
    """One operator with its inbox and outputs."""

    def __init__(
        self, name: str, operator: Operator[Any, Any], inputs: Mapping[str, Input],
        edges: Mapping[str, EdgeAccount], outs: Mapping[str, OutPort], account: NodeAccount,
        receiver: LocalReceiver, *, lockstep: bool, epoch: int,
    ) -> None:  # fmt: skip
        self.name, self.operator, self.outs = name, operator, dict(outs)
        self.edges, self.account, self.epoch = dict(edges), account, epoch
        self.lockstep = lockstep
        self._lock = threading.Lock()
        self._receiver = receiver
        self._asked: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self.ports: dict[str, InPort] = {}
        self.handover: Standby | None = None
        self.clocks = Clocks()
        self.inbox = Inbox(inputs, self.acknowledge, lockstep=lockstep, age_ns=self._age_ns)
        self.executor = Executor(name, operator, memory=self._loan)
        self._arrived_delay_ns = self._waiter = 0
        self.answered = 0  # sets of joined inputs handled by this instance
        self.scheduling_delay = SchedulingDelay()
        self.stopping = threading.Event()

    def acknowledge(self, name: str, outcome: str, ordinal: int) -> None:
        """Record the outcome of a message on one of this node's edges."""
        self.edges[name].acknowledge(outcome)
        if name in self.ports:
            self.ports[name].finished(ordinal)

    def deliver(self, name: str, arrival: Arrival) -> None:
        """Add an arrival; called by this runner's thread while it waits, or by a transport's."""
        phase, waited = arrival.header.seq % DELAY_EVERY, 0
        own = threading.get_ident() == self._waiter
        if own and phase in (0, DELAY_EVERY - 1):  # the one before only sets the reference
            waited = self.scheduling_delay.since_last_ns()
        with self._lock:
            self._arrived_delay_ns += 0 if phase else waited
            self.inbox.offer(name, arrival, time.monotonic_ns())
        if not own:
            self._receiver.wake()

    def lost(self, name: str) -> None:
        """Handle a loss on the way to an input, and announce it to the nodes downstream."""
        with self._lock:
            self.inbox.lost(name, time.monotonic_ns())
        for port in self.outs.values():
            port.has_lost()

    def rewire(self, name: str, account: EdgeAccount, port: InPort) -> None:
        """Connect an input to another edge; called on the thread that calls the handlers."""
        with self._lock:
            self.inbox.abandon(name)
            before = self.edges[name]
            self.ports[name].divert(lambda _arrival: before.acknowledge("unmatched"))
            self.edges[name], self.ports[name] = account, port

    def run(self) -> None:
        """Handle arrivals until `stop`; an operator's exception passes through."""
        self.alive("waiting")
        while not self.stopping.is_set():
            self.step()

    def between(self, act: Callable[[], None], *, must: bool = False) -> bool:
        """Queue an action between two calls of handlers; return False when the queue is full."""
        if self._asked.qsize() >= MOST_ASKED and not must:
            return False
        self._asked.put(act)
        self._receiver.wake()
        return True

    def do_asked(self) -> None:
        """Run queued actions; called on the thread that calls the handlers."""
        while not self._asked.empty():
            self._asked.get()()
        if self.handover is not None:
            self.handover.poll()

    def stop(self) -> None:
        """Make `run` return after the current message."""
        self.stopping.set()
        self._receiver.wake()

    def handshake(self) -> bool:
        """Send missing handshakes to readers; return whether all have had one."""
        return all([port.handshake() for port in self.outs.values()])

    def attend(self) -> None:
        """Exchange handshakes for a moment, before the first frame."""
        self.handshake()
        self._waiter = threading.get_ident()
        self._receiver.wait(HANDSHAKE_S)

    def next_work(self, timeout_s: float) -> Work | None:
        """Return the next call to make; None after the timeout."""
        with self._lock:
            work = self.inbox.take(time.monotonic_ns())
            if work is not None:
                return work
            due = self.inbox.due_ns()
        if due is not None:
            timeout_s = min(timeout_s, max(0.0, (due - time.monotonic_ns()) / 1e9))
        self._waiter = threading.get_ident()
        self._receiver.wait(timeout_s)
        with self._lock:
            return self.inbox.take(time.monotonic_ns())

    def step(self) -> None:
        """Wait once and make one call; keep no reference to its messages afterwards."""
        if self.handover is not None and self.handover.inactive:
            self.handover.stand_by(self._receiver)
            self.do_asked()
            return
        work = self._wait()
        if work is None:
            self.do_asked()
            return
        try:
            self._handle(work)
        except PoolExhausted:
            if not self.stopping.is_set():
                raise
        self.do_asked()

    def _wait(self) -> Work | None:
        complete = self.handshake()
        self.account.heartbeat_ns = time.monotonic_ns()
        return self.next_work(IDLE_S if complete else HANDSHAKE_S)

    def _handle(self, work: Work) -> None:
        begun = time.monotonic_ns()
        measured = not work.header.seq % DELAY_EVERY
        waited = (
            self.scheduling_delay.since_last_ns() + self._take_arrived_delay() if measured else 0
        )
        self.busy(begun, work.header.seq)
        if work.new_stream:
            self.operator.on_stream(work.header)
        side = bool(work.messages) and self.executor.is_side(tuple(work.messages))
        answers = self.executor.call(work.messages) if work.answer else {}
        ended = time.monotonic_ns()
        if not side:
            critical = _critical(work)
            ahead = self.clocks.ahead_ns(critical.clock) or 0
            waited = delay_on_the_way(critical, begun + ahead, waited)
            span = Span(
                stage=self.name, received_ns=begun + ahead, done_ns=ended + ahead,
                handler_ns=ended - begun, scheduling_delay_ns=waited,
            )  # fmt: skip
            self.publish(answers, stamped(critical, epoch=self.epoch, span=span))
            self.answered += 1
        if not (work.header.seq + 1) % DELAY_EVERY:
            self.scheduling_delay.since_last_ns()  # not the next message's
        for name, ordinal in work.arrived.items():
            self._count_age(name, work.header, begun)
            self.acknowledge(name, "delivered", ordinal)
        self.account.histograms["handler"].add(ended - begun)
        self._count_hop(work.header, begun)
        self.idle()

    def busy(self, now_ns: int, seq: int) -> None:
        """Record that a message is being handled."""
        account = self.account
        account.busy_since_ns = now_ns
        account.last_seq = max(0, seq)
        account.enter("busy")

    def idle(self) -> None:
        """Record that the message is finished."""
        self.account.handled += 1
        self.alive("waiting")

    def resume(self) -> None:
        """Restart the stall timer of the current message: waiting for others is no stall."""
        self.account.busy_since_ns = time.monotonic_ns()
        self.account.enter("busy")

    def alive(self, state: str) -> None:
        """Enter a state whose stalls only the heartbeat shows; beat first."""
        self.account.heartbeat_ns = time.monotonic_ns()
        self.account.enter(state)

    def publish(self, answers: Answers, header: Header) -> None:
        """Send the message of every output, waiting for the credit of lossless readers."""
        self.await_credit()
        self.send_all(answers, header)

    def send_all(self, answers: Answers, header: Header) -> None:
        """Send the message of every output with the outgoing header; raises `MessageError`."""
        for name, port in self.outs.items():
            message = answers.get(name)
            if message is not None:
                message = altered(message, header=header)
            try:
                try:
                    port.send(message, header)
                except PoolExhausted:
                    self.patiently(partial(port.send, message, header))
            except MessageError as error:
                raise MessageError(f"{self.name}.{name}: {error}") from error

    def has_credit(self) -> bool:
        """Whether every lossless reader of every output has room."""
        for port in self.outs.values():  # noqa: SIM110 - a hot path: no generator
            if not port.has_credit():
                return False
        return True

    def await_credit(self) -> None:
        """Apply back-pressure: wait while a lossless reader has no room."""
        if self.has_credit():
            return
        self.alive("credit")
        while not self.has_credit():
            if self.stopping.wait(CREDIT_S):
                return
            self.handshake()
            self.account.heartbeat_ns = time.monotonic_ns()
        self.resume()

    def patiently(self, act: Callable[[], Any]) -> Any:
        """Retry an action that needs a slot until a reader releases one."""
        while True:
            try:
                return act()
            except PoolExhausted:
                self.alive("credit")
                if self.stopping.wait(CREDIT_S):
                    raise
            finally:
                self.resume()

    def _loan(
        self, output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        port = self.outs.get(output)
        if port is None:  # it has no reader
            return np.empty(shape, dtype)
        return port.loan(shape, dtype, ahead=True) if ahead else self.lend(port, shape, dtype)

    def lend(self, port: OutPort, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return memory for an output, waiting until some is free."""
        try:
            return port.loan(shape, dtype)
        except PoolExhausted:
            memory: NDArray[Any] = self.patiently(lambda: port.loan(shape, dtype))
            return memory

    def _age_ns(self, header: Header, now_ns: int) -> int | None:
        return self.clocks.age_ns(header, now_ns)

    def _count_age(self, name: str, header: Header, now_ns: int) -> None:
        age = self.clocks.age_ns(header, now_ns)
        if age is not None:
            self.edges[name].age.add(age)

    def _count_hop(self, header: Header, now_ns: int) -> None:
        ahead = self.clocks.ahead_ns(header.clock)
        if header.trace and ahead is not None:
            self.account.histograms["hop"].add(now_ns + ahead - header.trace[-1].done_ns)

    def _take_arrived_delay(self) -> int:
        with self._lock:
            waited, self._arrived_delay_ns = self._arrived_delay_ns, 0
        return waited


def delay_on_the_way(header: Header, now_ns: int, waited_ns: int) -> int:
    """Return the part of a wait after the previous stage; the rest delayed no message."""
    since_ns = header.trace[-1].done_ns if header.trace else header.stamp_ns
    return max(0, min(waited_ns, now_ns - since_ns))


def _critical(work: Work) -> Header:
    """Return the header whose trace ended last: the critical path to this call."""
    headers = [m.header for m in work.messages.values() if m is not None] or [work.header]
    return max(headers, key=lambda h: h.trace[-1].done_ns if h.trace else 0)
