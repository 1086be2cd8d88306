"""Hand a running node over from one process to another without losing a message.

The successor is on standby with its own receiver: writers send to both, and it buffers. Between two
calls of handlers the predecessor stops reading, writes its state to shared memory and sends the
successor its position on every edge; the successor continues with unfinished and later messages.
The predecessor keeps receiving until its successor has passed probation, so that it can resume.
"""

import logging
import queue
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

from pipeline import codec
from pipeline.bus.envelope_buffer import DropCounts
from pipeline.bus.ledger import NodeAccount, private_ledger
from pipeline.bus.local_transport import LocalReceiver, connect
from pipeline.cause import cause_of
from pipeline.errors import FoveaError, MessageError, RunError
from pipeline.node.operator_runner import OperatorRunner
from pipeline.node.operator_state import WITHOUT, UndeclaredState, class_of, lost_words, restore
from pipeline.node.shadow import Heard, Shadow
from pipeline.private_folder import PrivateFolder
from pipeline.protocol.codec import decode, encode
from pipeline.protocol.handover import HandoverState
from pipeline.protocol.supervision import (
    Answered,
    Cut,
    CutMade,
    CutRefused,
    Event,
    Resumed,
    Shadowed,
    Standing,
    TakenOver,
)

HANDOVER_CHANNEL = 0xFFFFFFFF  # the "edge" on which a successor gets the state
REST_S = 0.005
MOST_STATE_BYTES = 1 << 30
ITS = "the running instance's"  # in a refusal, "its" would read as the successor's
MARGIN = 64  # descriptors buffered beyond what the other instance can have waiting
Say = Callable[[Event], None]
Listen = Callable[[Heard], Callable[[], None]]  # starts a tap, returns how to stop it
log = logging.getLogger(__name__)


class Takeover(NamedTuple):
    """The counts at the time when an instance took over."""

    answered: int  # sets of joined inputs
    dropped: dict[str, int]  # by input
    stopped_ns: int  # monotonic time when the predecessor stopped


class Queryables(Protocol):
    """The node's answers to questions, given only by the active instance."""

    def declare(self) -> None:
        """Start answering."""
        ...

    def undeclare(self) -> None:
        """Stop answering."""
        ...


class Handover:
    """One instance's side of a handover, on the thread that calls its handlers."""

    def __init__(
        self, runner: OperatorRunner, *, memory: PrivateFolder, say: Say, queryables: Queryables,
        listen: Listen, standby: bool,
    ) -> None:  # fmt: skip
        self._runner, self._memory = runner, memory
        self._say, self._queryables, self._listen = say, queryables, listen
        self._shadow: Shadow | None = None
        self._unlisten: Callable[[], None] = lambda: None
        self._account = runner.account
        self.inactive = self._standby = standby
        self._told = False
        self._requested: Cut | None = None
        self._before: dict[str, DropCounts] = {}
        self._received = b""
        self._first: Takeover | None = None  # set while its first output is awaited
        self._undeclared = UndeclaredState(runner.operator)
        if standby:
            runner.account = _nowhere()

    def stand_by(self, receiver: LocalReceiver) -> None:
        """Buffer messages for a moment; take over when the state has arrived."""
        ports = self._runner.ports
        for name, port in ports.items():
            seen = self._runner.edges[name].seen
            if port.buffer is not None:
                back = self._runner.inbox.capacity + MARGIN if self._standby else 0
                port.buffer.trim(seen - back)
        if not self._standby:
            for out in self._runner.outs.values():
                out.let_go()
        elif not self._told and all(
            p.buffer and p.buffer.complete_after is not None for p in ports.values()
        ):
            self._told = True
            heard = {
                name: port.buffer.complete_after or 0 for name, port in ports.items() if port.buffer
            }
            self._say(Standing(self._runner.name, heard))
        receiver.wait(REST_S)
        if self._shadow is not None:
            self._try(self._shadow)
        if self._received:
            handover, self._received = decode(HandoverState, self._received), b""
            if handover.shadow:
                self._begin_trial(handover)
            else:
                self._take_over(handover)

    def receive(self, handover: bytes) -> None:
        """Receive the predecessor's state: this instance is to take over."""
        self._received = handover

    def request(self, cut: Cut | None) -> None:
        """Request a stop as soon as possible; None cancels it."""
        self._requested = cut

    def poll(self) -> None:
        """Act on requests; called between two calls of handlers."""
        ports = self._runner.ports
        if self._first is not None and self._runner.answered > self._first.answered:
            first, self._first = self._first, None
            left_out = {name: port.dropped - first.dropped[name] for name, port in ports.items()}
            answered_ms = (time.monotonic_ns() - first.stopped_ns) / 1e6
            self._say(Answered(self._runner.name, left_out, answered_ms))
        if self._requested is not None and self._may_stop(self._requested):
            cut, self._requested = self._requested, None
            try:
                self._stop(cut)
            except (FoveaError, OSError) as error:
                self._remove_states()
                if self.inactive:
                    self.resume(self._runner.epoch)
                self._say(CutRefused(self._runner.name, str(error)))

    def resume(self, epoch: int) -> None:
        """Continue after a failed successor, behind the messages that it had finished."""
        if not self.inactive:
            return
        runner = self._runner
        self._remove_states()
        self._begin(epoch)
        done = {name: p.resume(epoch, self._before[name]) for name, p in runner.ports.items()}
        runner.inbox.forget(lambda name, ordinal: done[name](ordinal))
        for port in runner.ports.values():
            port.replay()
        self._activate()
        self._say(Resumed(runner.name))

    def confirm(self) -> None:
        """End the handover: the other instance is no longer needed."""
        for port in self._runner.ports.values():
            port.confirm()

    def _may_stop(self, cut: Cut) -> bool:
        if self._account.last_seq + 1 < cut.at:
            return False
        ports = self._runner.ports
        return all(ports[name].finished_up_to(heard) for name, heard in cut.heard.items())

    def _stop(self, cut: Cut) -> None:
        runner = self._runner
        state = "" if cut.fresh else self._write_state()
        link = connect(HANDOVER_CHANNEL, Path(cut.receiver))
        if link is None:
            raise RunError("the successor has closed its receiver")
        if cut.shadow:
            with link:
                edges = {name: port.here() for name, port in runner.ports.items()}
                handover = HandoverState(
                    edges=edges, position=runner.inbox.position(), state=state, shadow=cut.shadow,
                    operator=class_of(runner.operator),
                )  # fmt: skip
                link.send(encode(handover))
            return
        self._before = {name: DropCounts(account) for name, account in runner.edges.items()}
        position = runner.inbox.position()
        forgotten = [] if cut.fresh else self._undeclared.names()
        edges = {name: port.cut() for name, port in runner.ports.items()}
        self.inactive, runner.account = True, _nowhere()
        with link:
            for out in runner.outs.values():
                out.let_go()
            handover = HandoverState(
                edges=edges, position=position, stopped_ns=time.monotonic_ns(), state=state,
                operator=class_of(runner.operator), forgotten=forgotten,
            )  # fmt: skip
            link.send(encode(handover))
        self._say(CutMade(runner.name, int(self._account.last_seq)))
        self._queryables.undeclare()

    def _take_over(self, handover: HandoverState) -> None:
        runner = self._runner
        self._end_trial()
        for name, port in runner.ports.items():
            if port.buffer is None or port.buffer.incomplete:
                raise RunError(f"{runner.name}: the successor fell behind on {name}")
        state = self._read_state(handover)
        same = handover.operator == class_of(runner.operator)
        forgotten = handover.forgotten if same else []
        if forgotten:
            log.warning("%s: %s", runner.name, lost_words(forgotten))
        runner.inbox.go_on_from(handover.position)
        self._begin(runner.epoch)
        dropped = {name: port.dropped for name, port in runner.ports.items()}
        self._first = Takeover(runner.answered, dropped, handover.stopped_ns)
        for name, port in runner.ports.items():
            port.take_over(handover.edges[name])
        gap_ms = (time.monotonic_ns() - handover.stopped_ns) / 1e6
        self._say(
            TakenOver(
                node=runner.name, seq=int(self._account.last_seq), gap_ms=gap_ms, state=state,
                forgotten=forgotten,
            )
        )  # fmt: skip
        self._activate()

    def _begin_trial(self, handover: HandoverState) -> None:
        """Start a shadow run: handle the frames of the active instance and send nothing."""
        heard: Heard = queue.SimpleQueue()
        self._read_state(handover)
        self._unlisten = self._listen(heard)
        self._shadow = Shadow(
            self._runner, handover.position, handover.edges, heard, handover.shadow
        )

    def _try(self, shadow: Shadow) -> None:
        shadow.step()
        if shadow.done:
            self._end_trial()

    def _end_trial(self) -> None:
        if self._shadow is not None:
            self._say(Shadowed(self._runner.name, self._shadow.end()))
            self._unlisten()
            self._shadow = None

    def _begin(self, epoch: int) -> None:
        runner = self._runner
        runner.epoch, runner.account = epoch, self._account
        runner.account.epoch = epoch
        runner.alive("waiting")
        for out in runner.outs.values():
            out.begin(epoch)

    def _activate(self) -> None:
        self.inactive = self._standby = False
        self._queryables.declare()

    def _write_state(self) -> str:
        try:
            state = self._runner.operator.state()
        except Exception as error:  # the node keeps running: only the swap is refused
            raise RunError(f"{ITS} state() failed: {cause_of(error)}{WITHOUT}") from error
        if state is None:
            return ""
        name = f"{self._runner.name}.{self._runner.epoch}.state"
        self._remove_states()
        try:
            data = codec.dumps(state)
        except MessageError as error:
            raise RunError(f"{ITS} state cannot be written: {error}{WITHOUT}") from error
        self._memory.write(name, data)
        return name

    def _remove_states(self) -> None:
        """Remove states that no successor has read, because it ended before."""
        for name in filter(self._is_state, self._memory.names()):
            self._memory.remove(name)

    def _is_state(self, name: str) -> bool:
        return bool(re.fullmatch(rf"{re.escape(self._runner.name)}\.\d+\.state", name))

    def _read_state(self, handover: HandoverState) -> str:
        """Restore the predecessor's state in the operator; return the outcome as text."""
        name, operator = handover.state, self._runner.operator
        if not name:
            return "none"
        if not self._is_state(name):
            raise MessageError(f"{self._runner.name}: the state lies in a file that is not its own")
        try:
            data = self._memory.read(name, MOST_STATE_BYTES)
            return restore(operator, data, must=handover.operator == class_of(operator))
        except FoveaError as error:
            raise RunError(f"{self._runner.name}: {error}") from error
        except OSError as error:
            raise RunError(f"{self._runner.name}: the state cannot be read: {error}") from error
        finally:
            self._memory.remove(name)


def _nowhere() -> NodeAccount:
    """Return an account for an instance that is not active."""
    return private_ledger(0, 1).nodes[0]
