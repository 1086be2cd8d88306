"""Messages between supervisor and node process: instructions and events.

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

MOST_EVENT_BYTES = 1 << 20  # a longer summary is left out
MOST_INSTRUCTION_BYTES = 8 << 20  # an assignment contains a plan and its contracts


class PortContract(Part, frozen=True, kw_only=True):
    """Message types (`module:Class`) by input and output, checkable without imports."""

    inputs: dict[str, str]
    outputs: dict[str, str]
    source: bool


class Imported(Part, frozen=True):
    """Facts about a process's imported code, for the supervisor."""

    ports: dict[str, Ports] = {}  # by operator
    files: list[str] = []  # source files outside installed packages


class Assignment(ControlMessage, frozen=True, kw_only=True):
    """The nodes for a process to run."""

    plan: Plan
    process: str
    run_folder: str
    memory_folder: str
    epochs: dict[str, int]  # by node
    frames: int = 0
    network: Network | None = None  # to nodes on other hosts, if it has edges there
    standby: bool = False  # another instance is active until this one takes over
    trial: bool = False  # only check operators and settings, then exit
    contracts: dict[str, PortContract] = {}  # checked before the start

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The nodes of the process."""
        here = filter(self.plan.is_here, self.plan.nodes)
        return tuple(node for node in here if node.process == self.process)

    def receiver(self, node: str, instance: int) -> Path:
        """Return the receiver's address of a node's instance."""
        return Path(self.run_folder) / f"{node}.{instance}.recv"

    @property
    def instance(self) -> str:
        """The name of this instance of the process on the bus."""
        return f"{self.process}.{max(self.epochs.values())}"

    def sockets(self) -> list[str]:
        """The names of sockets that this instance may leave behind when it is killed."""
        if self.trial:
            return []  # it opens none, and has the epoch of the active instance
        receivers = [self.receiver(node, epoch).name for node, epoch in self.epochs.items()]
        return [*receivers, f"{self.instance}.sock", f"{self.instance}.sock.lock"]


class Inspect(ControlMessage, frozen=True):
    """Only check a plan's operators of this host; answered by `Fits` or `Failed`."""

    plan: Plan
    fingerprints: dict[str, str]  # of the expected messages, by `node.output`
    files: dict[str, str]  # module -> file whose checksum was compared with the allow list
    log: str  # file for what operators print
    timeout_s: float


class Go(ControlMessage, frozen=True):
    """Begin to run: all conditions are met."""


class Finish(ControlMessage, frozen=True):
    """Make sources stop producing."""


class Stop(ControlMessage, frozen=True):
    """End the process."""


class Replan(ControlMessage, frozen=True):
    """Reconnect a node by this plan; operator and settings stay."""

    node: str
    plan: Plan


class Cut(ControlMessage, frozen=True, kw_only=True):
    """Stop at frame `at` or later, after handling everything the successor has not received."""

    node: str
    receiver: str  # of the successor
    heard: dict[str, int]  # by input: the successor has received everything after this ordinal
    at: int = 0
    shadow: int = 0  # frames of a shadow run: do not stop, only send the position
    fresh: bool = False  # the successor gets no state


class Uncut(ControlMessage, frozen=True):
    """Cancel a `Cut`."""

    node: str


class Resume(ControlMessage, frozen=True):
    """Continue under this epoch: the successor has failed."""

    node: str
    epoch: int


class Confirm(ControlMessage, frozen=True):
    """The other instance is no longer needed."""

    node: str


NodeInstruction = Replan | Cut | Uncut | Resume | Confirm
Instruction = Assignment | Inspect | Go | Finish | Stop | NodeInstruction
INSTRUCTION: Kind[Instruction] = Kind("an instruction", Instruction, MOST_INSTRUCTION_BYTES)


class Idle(ControlMessage, frozen=True):
    """Every module is imported; the first instruction may come."""


class Fits(ControlMessage, frozen=True):
    """Operators and settings fit: the answer to a trial and to `Inspect`."""

    imported: Imported = Imported()


class Ready(ControlMessage, frozen=True):
    """Every operator is open."""

    load_s: float  # time to open in seconds
    imported: Imported = Imported()


class Failed(ControlMessage, frozen=True):
    """The first error of a process; it ends."""

    error: str
    expected: bool  # raised on purpose, a `FoveaError`


class Leaving(ControlMessage, frozen=True):
    """The process announces its end."""


class Finished(ControlMessage, frozen=True):
    """A source has produced its last frame."""

    node: str


class Headline(ControlMessage, frozen=True):
    """An operator's headline."""

    node: str
    words: str


class Summary(ControlMessage, frozen=True):
    """An operator's summary at its end, for the report."""

    node: str
    figures: dict[str, Any]
    left_out: str = ""  # which figures are missing, and why


class Replanned(ControlMessage, frozen=True):
    """A node is connected by its new plan."""

    node: str


class Standing(ControlMessage, frozen=True):
    """A successor receives on every input."""

    node: str
    heard: dict[str, int]  # by input: complete after this ordinal


class Shadowed(ControlMessage, frozen=True):
    """A successor has handled enough frames of its predecessor."""

    node: str
    report: ShadowReport


class CutMade(ControlMessage, frozen=True):
    """The predecessor has stopped and handed over."""

    node: str
    seq: int  # its last frame


class CutRefused(ControlMessage, frozen=True):
    """The predecessor could not stop and remains active."""

    node: str
    reason: str


class TakenOver(ControlMessage, frozen=True, kw_only=True):
    """The successor is active."""

    node: str
    seq: int
    gap_ms: float
    state: str
    forgotten: list[str]


class Answered(ControlMessage, frozen=True):
    """The successor has sent its first output."""

    node: str
    left_out: dict[str, int]  # frames by input
    answered_ms: float  # since its predecessor stopped


class Resumed(ControlMessage, frozen=True):
    """The predecessor is active again."""

    node: str


Event = (
    Idle | Fits | Ready | Failed | Leaving | Finished | Headline | Summary | Replanned | Standing
    | Shadowed | CutMade | CutRefused | TakenOver | Answered | Resumed
)  # fmt: skip
EVENT: Kind[Event] = Kind("an event", Event, MOST_EVENT_BYTES)
