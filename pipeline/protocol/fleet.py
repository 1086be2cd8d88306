"""Messages from client to agent, and between agents: graphs on several hosts.

The verb is part of the key, which the access list binds to a certificate; every reply may be a
`Refused`. The decoder checks the form of a message, the agent its content. Weight files are sent
unchanged, by the verb `weights`.
"""

from importlib import metadata
from typing import Any

from pipeline.bus import envelope
from pipeline.graph.plan import Plan
from pipeline.protocol.codec import ControlMessage, Part
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.questions import NodeQuestion


class Versions(Part, frozen=True):
    """The versions that must be equal on all hosts."""

    fovea: str
    zenoh: str
    envelope: int

    def __str__(self) -> str:
        return f"fovea {self.fovea}, Zenoh {self.zenoh}, envelope {self.envelope}"

    @staticmethod
    def ours() -> "Versions":
        """Return the versions of this installation."""
        zenoh = ".".join(metadata.version("eclipse-zenoh").split(".")[:2])
        return Versions(metadata.version("fovea"), zenoh, envelope.VERSION)


class Nothing(ControlMessage, frozen=True):
    """A question without parameters."""


class About(ControlMessage, frozen=True):
    """The identity and versions of an agent."""

    label: str
    versions: Versions
    graphs: tuple[str, ...]


class Prepare(ControlMessage, frozen=True):
    """Ask whether a plan may run here, without starting it; answered by `Prepared`."""

    plan: Plan
    versions: Versions
    fingerprints: dict[str, str]  # node.output -> fingerprint of its message
    replace: bool = False


class Prepared(ControlMessage, frozen=True):
    """The plan may run; contains the end points of processes with an edge to another host."""

    endpoints: dict[str, str]
    weights: tuple[str, ...] = ()  # checksums allowed here but not present yet


class Start(ControlMessage, frozen=True):
    """Run this host's part of the plan; answered by `Accepted`."""

    plan: Plan
    versions: Versions
    fingerprints: dict[str, str]  # as in `Prepare`
    endpoints: dict[str, str]  # of all listening processes
    hosts: dict[str, str]  # label -> end point of its agent
    identity: str = ""  # of the graph, if its nodes have changed since; else from the plan


class Named(ControlMessage, frozen=True):
    """A question about one graph."""

    graph: str


class Lines(ControlMessage, frozen=True):
    """Ask for the last lines of a node's log, or for those from a byte on."""

    graph: str
    node: str
    count: int = 40
    begin: int | None = None


class Log(ControlMessage, frozen=True):
    """Lines of a node's log, and the byte behind them."""

    lines: tuple[str, ...]
    end: int


class ToNode(ControlMessage, frozen=True):
    """A question to a node, as asked on the node's own host; answered by `Relayed`."""

    graph: str
    node: str
    question: NodeQuestion


class Relayed(ControlMessage, frozen=True):
    """The reply of a node or of the supervisor there, as encoded by it."""

    payload: bytes


class Lacks(ControlMessage, frozen=True):
    """Ask which of these weights are allowed but not present; answered by `Missing`."""

    digests: tuple[str, ...]


class Missing(ControlMessage, frozen=True):
    """The checksums of missing weights."""

    digests: tuple[str, ...]


class Accepted(ControlMessage, frozen=True):
    """The request was carried out."""

    what: str = ""  # the checksum of stored weights


class Change(ControlMessage, frozen=True):
    """Swap a node; answered by `Relayed` with its supervisor's reply."""

    graph: str
    order: SwapOrder


class TapQuestion(ControlMessage, frozen=True):
    """Ask what an output has sent since the last question; answered by `TapMessages`."""

    graph: str
    node: str
    output: str
    tap: str  # a name chosen by the client


class TapMessages(ControlMessage, frozen=True):
    """The messages of an output as descriptors, without their pictures."""

    heard: tuple[tuple[int, bytes], ...]  # arrival by this host's clock, descriptor
    skipped: int  # for lack of room, since the tap was opened
    now_ns: int  # by this host's clock
    ahead_ns: dict[str, int]  # by label: offset to this host's time


class Planned(ControlMessage, frozen=True):
    """The plan of a host; the reply to `Named`."""

    plan: Plan
    revision: int  # of the running plan


class PlanChange(ControlMessage, frozen=True):
    """Add or remove nodes and edges of a host; answered by `Relayed`."""

    graph: str
    plan: Plan
    versions: Versions
    fingerprints: dict[str, str]  # of outputs with new edges
    revision: int


class Ping(ControlMessage, frozen=True):
    """A probe with the sender's time."""

    sent_ns: int


class Pong(ControlMessage, frozen=True):
    """Times of a ping's departure and arrival, and of this reply; the last two by the replier."""

    sent_ns: int
    came_ns: int
    left_ns: int


class Accounts(ControlMessage, frozen=True):
    """One host's half of the accounts of edges between hosts: edge -> counters in fixed order."""

    number: int  # increases with every message of one start
    fingerprint: str  # of the running graph: another one has other edges
    ready: bool  # whether every process there has opened its operators
    written: dict[int, tuple[int, ...]]
    read: dict[int, tuple[int, ...]]


class Process(Part, frozen=True):
    """A process as `ps` shows it."""

    name: str
    nodes: tuple[str, ...]
    pid: int
    cpu_s: float
    rss_mb: float
    restarts: int
    crashes: int  # unexpected ends


class NodeState(Part, frozen=True):
    """A node as `top` shows it."""

    name: str
    condition: str
    epoch: int
    handled: int
    last_seq: int
    handler_ms: dict[str, float]
    hop_ms: dict[str, float]
    loop_ms: dict[str, float]
    provider: str = ""  # what computes its networks; empty without one

    @property
    def opened(self) -> bool:
        """Whether its operator has been opened by its current process."""
        return self.condition not in ("absent", "starting")


class EdgeState(Part, frozen=True):
    """An edge, seen from the host of its reader."""

    origin: str
    end: str
    account: dict[str, Any]
    age_ms: dict[str, float]
    age_error_ms: float
    broken: bool
    sent: int


class HostState(Part, frozen=True):
    """Another host, seen from this one."""

    label: str
    lost: bool
    lost_for_s: float
    losses: int
    clock_ahead_ms: float
    clock_error_ms: float  # 0: not known yet
    round_trip_ms: float


class State(Part, frozen=True):
    """The state of one host's part of a graph."""

    graph: str
    label: str
    at_ns: int  # time by the host's clock
    phase: str  # starting | running | failed | stopped
    failure: str
    processes: tuple[Process, ...]
    nodes: tuple[NodeState, ...]
    edges: tuple[EdgeState, ...]
    hosts: tuple[HostState, ...]
    network_bytes: dict[str, tuple[int, int]]  # interface -> received, sent, of the whole host


class States(ControlMessage, frozen=True):
    """The states of all parts of graphs on one host."""

    states: tuple[State, ...]
