"""Run a source: at its own rate, or in lockstep with the graph.

Sensor commands have their own thread, so that one that arrives during an exposure is accepted at
once. The loop latency ends here: picture ready -> command accepted.
"""

import hashlib
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.bus.clocks import ALONE
from pipeline.bus.inbox import Work
from pipeline.bus.outport import OutPort
from pipeline.contract import Source
from pipeline.errors import PoolExhausted
from pipeline.executor import Answers, header_of
from pipeline.graph.limits import DAY_S
from pipeline.messages import Header, Message, Span, altered, stamped
from pipeline.node.operator_runner import DELAY_EVERY, IDLE_S, OperatorRunner, delay_on_the_way

DRAIN_S = 0.0001


class SourceRunner(OperatorRunner):
    """A runner of a source, for at most `limit` exposures (0: until the source ends)."""

    def __init__(self, *args: Any, drained: Callable[[], bool], limit: int, **kw: Any) -> None:
        super().__init__(*args, **kw)
        self._drained, self._limit = drained, limit
        self._ending = threading.Event()
        self.on_finished: Callable[[], None] = lambda: None
        self._broken: BaseException | None = None  # raised by the handler of commands
        self.commands = hashlib.sha256()

    def run(self) -> None:
        """Expose until the source ends, the limit is reached or `stop` is called.

        The operator's exceptions pass through, also those from the thread for commands.
        """
        assert isinstance(self.operator, Source)
        self.account.absent_until_ns = 0  # not that of an instance before
        commands = threading.Thread(target=self._command_loop, name=f"{self.name}-commands")
        commands.start()
        self.alive("waiting")
        exposures = 0
        try:
            while not self._ending.is_set() and (not self._limit or exposures < self._limit):
                self.handshake()
                self.do_asked()
                if self.lockstep and not self._await_answer():
                    break
                if not self._expose():
                    break
                exposures += 1
            if self._broken is None:
                self.account.enter("finished")
                self.on_finished()
            while not self.stopping.wait(0.2):
                self.handshake()
                self.account.heartbeat_ns = time.monotonic_ns()
                self.do_asked()
        finally:
            self.stopping.set()
            commands.join()
        if self._broken is not None:
            raise self._broken

    def end(self) -> None:
        """Stop producing frames, but accept commands until `stop`."""
        self._ending.set()

    def stop(self) -> None:
        """Make `run` return after the current exposure."""
        self._ending.set()
        super().stop()

    def note_absence(self) -> None:
        """Record whether the source waits for a lost device; called by another thread."""
        assert isinstance(self.operator, Source)
        self.account.absent_until_ns = absence_ns(
            self.operator.absent_until_s, self.account.absent_until_ns, time.monotonic_ns()
        )

    def figures(self) -> dict[str, Any]:
        """Return the report's figures on received commands."""
        return {"schedule_sha256": self.commands.hexdigest()}

    def _expose(self) -> bool:
        begun = time.monotonic_ns()
        self.busy(begun, int(self.account.last_seq))
        frames: Answers | None = None
        before = {name: port.newest for name, port in self.outs.items()}
        try:
            frames = self.executor.produce()
            if frames is None:
                return False
            self._send(frames, begun)
        except PoolExhausted:
            for name, port in self.outs.items():
                port.give_back((frames or {}).get(name))
                port.discard()
                if port.newest == before[name]:  # else this output had room, and was sent
                    port.overrun()
        self.idle()
        return True

    def _send(self, frames: Answers, begun_ns: int) -> None:
        header = header_of(frames)
        if not self.lockstep and not self.has_credit():
            raise PoolExhausted(f"{self.name}: a lossless reader has no room")
        ended = time.monotonic_ns()
        ready = max(begun_ns, header.stamp_ns)  # before that the source waited for its sensor
        span = Span(
            stage=self.name, received_ns=header.stamp_ns, done_ns=ended, handler_ns=ended - ready,
            scheduling_delay_ns=0,
        )  # fmt: skip
        leaving = stamped(header, epoch=self.epoch, span=span)
        if self.clocks.own != ALONE:  # other hosts need the clock's label
            leaving = altered(leaving, clock=self.clocks.own)
        if self.lockstep:
            self.await_credit()
        self.send_all(frames, leaving)
        self.account.last_seq = header.seq
        self.account.histograms["handler"].add(ended - ready)

    def lost(self, name: str) -> None:
        """Ignore a lost command: the frames start here."""

    def lend(self, port: OutPort, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return memory without waiting, since an exposure in real time cannot wait."""
        return super().lend(port, shape, dtype) if self.lockstep else port.loan(shape, dtype)

    def patiently(self, act: Callable[[], Any]) -> Any:
        """Run an action without retries in real time: no free slot is an overrun."""
        return super().patiently(act) if self.lockstep else act()

    def _await_answer(self) -> bool:
        """Wait, in lockstep, until the graph has handled everything sent."""
        while not self._drained():
            self.account.heartbeat_ns = time.monotonic_ns()
            if self.stopping.wait(DRAIN_S):
                return False
            self.handshake()
        return True

    def _command_loop(self) -> None:
        try:
            while not self.stopping.is_set():
                if (work := self.next_work(IDLE_S)) is not None:
                    self._accept(work)
        except BaseException as error:  # reported by the exposing thread
            self._broken = error
            self.stop()

    def _accept(self, work: Work) -> None:
        begun = time.monotonic_ns()
        waited = self._take_arrived_delay()
        ((name, message),) = work.messages.items()
        if message is not None:
            self.executor.call(work.messages)
            accepted = time.monotonic_ns()
            fold(self.commands, message)
            waited = delay_on_the_way(message.header, begun, waited)
            self._count_loop(message.header, accepted, accepted - begun, waited)
        self._count_age(name, work.header, begun)
        self.acknowledge(name, "delivered", work.arrived[name])

    def _count_loop(self, header: Header, now_ns: int, handler_ns: int, waited_ns: int) -> None:
        latency = now_ns - header.stamp_ns
        self.account.histograms["loop"].add(latency)
        if header.seq % DELAY_EVERY:
            return
        handlers = handler_ns + sum(span.handler_ns for span in header.trace)
        waited = waited_ns + sum(span.scheduling_delay_ns for span in header.trace)
        histograms = self.account.histograms
        histograms["scheduling_delay"].add(waited)
        histograms["overhead"].add(max(0, latency - handlers - waited))


def absence_ns(until_s: float, before_ns: int, now_ns: int) -> int:
    """Return until when a source waits for its device, as its account has it.

    A source that waits no longer gets the time of now, from which on a stall counts.

    >>> absence_ns(5.0, 0, 2_000_000_000), absence_ns(0.0, 5_000_000_000, 3_000_000_000)
    (5000000000, 3000000000)
    >>> absence_ns(0.0, 5_000_000_000, 9_000_000_000), absence_ns(float("inf"), 0, 0)
    (5000000000, 86400000000000)
    """
    now_s = now_ns / 1e9
    if until_s > now_s:
        return round(min(until_s, now_s + DAY_S) * 1e9)
    return min(before_ns, now_ns)


def fold(digest: Any, message: Message) -> None:
    """Add a command's content, without its times, to a running hash."""
    seq = message.header.seq & (1 << 64) - 1  # whatever a wrong message says
    digest.update(seq.to_bytes(8, "little"))
    for name, value in vars(message).items():
        if name != "header":
            plain = value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
            digest.update(name.encode() + plain)
