"""Supervisor to node process, and back: what it is to do, what happens there.

The first instruction is an `Assignment` or an `Inspect`, the last event is `Leaving`. Each is a
line on the socket between the two (`pipeline.protocol.lines`).
"""

from pathlib import Path
from typing import Any

from pipeline.bus.network import Network
from pipeline.graph.plan import Node, Plan
from pipeline.graph.ports import Ports
from pipeline.protocol.codec import ControlMessage, Kind, Part
from pipeline.protocol.orders import ShadowReport

MOST_EVENT_BYTES = 1 << 20  # a summary that is longer is left out
MOST_INSTRUCTION_BYTES = 8 << 20  # an assignment holds a plan and what its edges carry


class PortContract(Part, frozen=True, kw_only=True):
    """Message types (`module:Class`) by input and output, so that nobody has to import others."""

    inputs: dict[str, str]
    outputs: dict[str, str]
    source: bool


class Imported(Part, frozen=True):
    """What the supervisor has to know of code that it does not import."""

    ports: dict[str, Ports] = {}  # by operator
    files: list[str] = []  # of modules that are no part of an installed package


class Assignment(ControlMessage, frozen=True, kw_only=True):
    """What a process is to run."""

    plan: Plan
    process: str
    run_folder: str
    memory_folder: str
    epochs: dict[str, int]  # by node
    frames: int = 0
    network: Network | None = None  # to the nodes on other hosts, where an edge leads there
    standby: bool = False  # another instance works until this one is told to take over
    trial: bool = False  # only say whether operators and settings fit, and leave
    contracts: dict[str, PortContract] = {}  # checked before the start

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The nodes of the process."""
        here = filter(self.plan.is_here, self.plan.nodes)
        return tuple(node for node in here if node.process == self.process)

    def receiver(self, node: str, instance: int) -> Path:
        """Where an instance of a node receives."""
        return Path(self.run_folder) / f"{node}.{instance}.recv"

    @property
    def instance(self) -> str:
        """The name of this instance of the process on the bus."""
        return f"{self.process}.{max(self.epochs.values())}"

    def sockets(self) -> list[str]:
        """The names of what this instance may leave in the run folder when it is killed."""
        if self.trial:
            return []  # it opens none, and bears the epoch of the instance that works
        receivers = [self.receiver(node, epoch).name for node, epoch in self.epochs.items()]
        return [*receivers, f"{self.instance}.sock", f"{self.instance}.sock.lock"]


class Inspect(ControlMessage, frozen=True):
    """Instead of an assignment: do the operators of this host fit their plan? Answered by `Fits`
    or `Failed`; the process ends."""

    plan: Plan
    fingerprints: dict[str, str]  # of the messages that are meant, by `node.output`


class Go(ControlMessage, frozen=True):
    """Begin: everything that was waited for is there."""


class Finish(ControlMessage, frozen=True):
    """Sources: make no more frames."""


class Stop(ControlMessage, frozen=True):
    """End."""


class Replan(ControlMessage, frozen=True):
    """Connect a node as this plan has it; its operator and settings stay."""

    node: str
    plan: Plan


class Cut(ControlMessage, frozen=True, kw_only=True):
    """Stop at frame `at` or later, once everything is done that the successor has not received."""

    node: str
    receiver: str  # of the successor
    heard: dict[str, int]  # by input: the successor has received what came after this ordinal
    at: int = 0
    shadow: int = 0  # frames: do not stop, only tell the successor how far this instance is


class Uncut(ControlMessage, frozen=True):
    """Do not stop after all."""

    node: str


class Resume(ControlMessage, frozen=True):
    """Continue under this epoch: the successor has failed."""

    node: str
    epoch: int


class Confirm(ControlMessage, frozen=True):
    """The other instance is not needed any more."""

    node: str


NodeInstruction = Replan | Cut | Uncut | Resume | Confirm
Instruction = Assignment | Inspect | Go | Finish | Stop | NodeInstruction
INSTRUCTION: Kind[Instruction] = Kind("an instruction", Instruction, MOST_INSTRUCTION_BYTES)


class Idle(ControlMessage, frozen=True):
    """Every module is imported; an assignment may come."""


class Fits(ControlMessage, frozen=True):
    """Operators and settings fit: the answer to a trial and to `Inspect`."""

    imported: Imported = Imported()


class Ready(ControlMessage, frozen=True):
    """Every operator is open."""

    load_s: float  # time that took
    imported: Imported = Imported()


class Failed(ControlMessage, frozen=True):
    """The first error of a process; it ends."""

    error: str
    expected: bool  # it was raised on purpose


class Leaving(ControlMessage, frozen=True):
    """The process ends by itself."""


class Finished(ControlMessage, frozen=True):
    """A source has made its last frame."""

    node: str


class Headline(ControlMessage, frozen=True):
    """What an operator tells while it runs."""

    node: str
    words: str


class Summary(ControlMessage, frozen=True):
    """What an operator tells at its end, for the report."""

    node: str
    figures: dict[str, Any]
    left_out: str = ""  # why there are no figures


class Replanned(ControlMessage, frozen=True):
    """A node is connected as its new plan has it."""

    node: str


class Standing(ControlMessage, frozen=True):
    """A successor receives on every input."""

    node: str
    heard: dict[str, int]  # by input: nothing is missing after this ordinal


class Shadowed(ControlMessage, frozen=True):
    """A successor has answered enough frames of its predecessor."""

    node: str
    report: ShadowReport


class CutMade(ControlMessage, frozen=True):
    """The predecessor has stopped and handed over."""

    node: str
    seq: int  # its last frame


class CutRefused(ControlMessage, frozen=True):
    """The predecessor works on: it could not stop."""

    node: str
    reason: str


class TakenOver(ControlMessage, frozen=True, kw_only=True):
    """The successor works."""

    node: str
    seq: int
    gap_ms: float
    state: str
    forgotten: list[str]


class Answered(ControlMessage, frozen=True):
    """The successor has given its first answer."""

    node: str
    left_out: dict[str, int]  # frames by input
    answered_ms: float  # since its predecessor stopped


class Resumed(ControlMessage, frozen=True):
    """The predecessor works again."""

    node: str


Event = (
    Idle | Fits | Ready | Failed | Leaving | Finished | Headline | Summary | Replanned | Standing
    | Shadowed | CutMade | CutRefused | TakenOver | Answered | Resumed
)  # fmt: skip
EVENT: Kind[Event] = Kind("an event", Event, MOST_EVENT_BYTES)
