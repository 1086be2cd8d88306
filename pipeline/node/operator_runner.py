"""Runs one operator: arrivals to handler calls, answers to output ports, progress to the ledger.

The same for a process of its own and for a group; the transport's threads only deliver, the
runner's own thread calls the operator.
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

IDLE_S = 0.2  # the heartbeat of a runner that has nothing to do
HANDSHAKE_S = 0.02  # while a reader has not heard us yet
CREDIT_S = 0.0005
MOST_ASKED = 64  # questions that may wait for a handler to return
DELAY_EVERY = 8  # the kernel's accounts are asked for every eighth exposure: asking takes time too


class Standby(Protocol):
    """What may keep a runner inactive: another instance works in its place (`handover`)."""

    inactive: bool

    def stand_by(self, receiver: LocalReceiver) -> None:
        """Wait for a moment."""
        ...

    def poll(self) -> None:
        """See whether the time has come to stop."""
        ...


class OperatorRunner:
    """One operator with its inbox and its outputs."""

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
        self.answered = 0  # sets of joined inputs, by this instance
        self.scheduling_delay = SchedulingDelay()
        self.stopping = threading.Event()

    def acknowledge(self, name: str, outcome: str, ordinal: int) -> None:
        """Account for the end of a message on one of this node's edges."""
        self.edges[name].acknowledge(outcome)
        if name in self.ports:
            self.ports[name].finished(ordinal)

    def deliver(self, name: str, arrival: Arrival) -> None:
        """Called while this runner waits at its receiver, or by a transport's thread."""
        phase, waited = arrival.header.seq % DELAY_EVERY, 0
        own = threading.get_ident() == self._waiter
        if own and phase in (0, DELAY_EVERY - 1):  # the one before only sets the mark
            waited = self.scheduling_delay.since_last_ns()
        with self._lock:
            self._arrived_delay_ns += 0 if phase else waited
            self.inbox.offer(name, arrival, time.monotonic_ns())
        if not own:
            self._receiver.wake()

    def lost(self, name: str) -> None:
        """Frames that were on their way to an input are gone: those after it have to know."""
        with self._lock:
            self.inbox.lost(name, time.monotonic_ns())
        for port in self.outs.values():
            port.has_lost()

    def rewire(self, name: str, account: EdgeAccount, port: InPort) -> None:
        """Let an input be another edge; to be called by the thread that calls the handlers."""
        with self._lock:
            self.inbox.abandon(name)
            before = self.edges[name]
            self.ports[name].divert(lambda _arrival: before.acknowledge("unmatched"))
            self.edges[name], self.ports[name] = account, port

    def run(self) -> None:
        """Handle what arrives until told to stop; an operator's exception passes through."""
        self.alive("waiting")
        while not self.stopping.is_set():
            self.step()

    def between(self, act: Callable[[], None], *, must: bool = False) -> bool:
        """Have something done between two calls of handlers; False when too much waits already."""
        if self._asked.qsize() >= MOST_ASKED and not must:
            return False
        self._asked.put(act)
        self._receiver.wake()
        return True

    def do_asked(self) -> None:
        """Do what was asked for; to be called by the thread that calls the handlers."""
        while not self._asked.empty():
            self._asked.get()()
        if self.handover is not None:
            self.handover.poll()

    def stop(self) -> None:
        """Let `run` return after the message in hand."""
        self.stopping.set()
        self._receiver.wake()

    def handshake(self) -> bool:
        """Send a handshake to readers that have not heard this instance; True when all have."""
        return all([port.handshake() for port in self.outs.values()])

    def attend(self) -> None:
        """Before the first frame: exchange handshakes, for a moment."""
        self.handshake()
        self._waiter = threading.get_ident()
        self._receiver.wait(HANDSHAKE_S)

    def next_work(self, timeout_s: float) -> Work | None:
        """What to do next; None when nothing came in time."""
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
        """One wait and one call, of which nothing is held while the next is waited for."""
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
            self.scheduling_delay.since_last_ns()  # that was not the next message's
        for name, ordinal in work.arrived.items():
            self._count_age(name, work.header, begun)
            self.acknowledge(name, "delivered", ordinal)
        self.account.histograms["handler"].add(ended - begun)
        self._count_hop(work.header, begun)
        self.idle()

    def busy(self, now_ns: int, seq: int) -> None:
        """Note that a message was taken."""
        account = self.account
        account.busy_since_ns = now_ns
        account.last_seq = max(0, seq)
        account.enter("busy")

    def idle(self) -> None:
        """Note that it was finished."""
        self.account.handled += 1
        self.alive("waiting")

    def resume(self) -> None:
        """Go on with the message in hand; what was waited for others is no stall of this node."""
        self.account.busy_since_ns = time.monotonic_ns()
        self.account.enter("busy")

    def alive(self, state: str) -> None:
        """Enter a state in which only the heartbeat tells a stall: it has to beat first."""
        self.account.heartbeat_ns = time.monotonic_ns()
        self.account.enter(state)

    def publish(self, answers: Answers, header: Header) -> None:
        """Send every output's answer, waiting for the credit of lossless readers."""
        self.await_credit()
        self.send_all(answers, header)

    def send_all(self, answers: Answers, header: Header) -> None:
        """Send every output's answer under the header that leaves; raises `MessageError`."""
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
        for port in self.outs.values():  # noqa: SIM110 - for every message: no generator
            if not port.has_credit():
                return False
        return True

    def await_credit(self) -> None:
        """Back-pressure: stand still while a lossless reader has no room."""
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
        """Do something that needs a slot, as soon as a reader gives one back."""
        while True:
            try:
                return act()
            except PoolExhausted:
                self.alive("credit")
                if self.stopping.wait(CREDIT_S):
                    raise
            finally:
                self.resume()

    def _loan(self, output: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        port = self.outs.get(output)
        if port is None:  # nobody reads it
            return np.empty(shape, dtype)
        return self.lend(port, shape, dtype)

    def lend(self, port: OutPort, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Memory for an output; waits until there is some."""
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
    """What of a wait lies between the stage before and now; the rest held up no message."""
    since_ns = header.trace[-1].done_ns if header.trace else header.stamp_ns
    return max(0, min(waited_ns, now_ns - since_ns))


def _critical(work: Work) -> Header:
    """The header whose trace ended last: the path that decided when this call could begin."""
    headers = [m.header for m in work.messages.values() if m is not None] or [work.header]
    return max(headers, key=lambda h: h.trace[-1].done_ns if h.trace else 0)
