"""Client to agent, and agent to agent: graphs that run on several hosts.

The verb stands in the key, which the access list ties to a certificate; every answer may be a
`Refused`. Form is checked where a message is decoded, what it asks for by the agent. Files of
weights travel as they are, by the verb `weights`.
"""

from importlib import metadata
from typing import Any

from pipeline.bus import envelope
from pipeline.graph.plan import Plan
from pipeline.protocol.codec import ControlMessage, Part
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.questions import NodeQuestion


class Versions(Part, frozen=True):
    """What has to be the same on all hosts."""

    fovea: str
    zenoh: str
    envelope: int

    def __str__(self) -> str:
        return f"fovea {self.fovea}, Zenoh {self.zenoh}, envelope {self.envelope}"

    @staticmethod
    def ours() -> "Versions":
        """Of this installation."""
        zenoh = ".".join(metadata.version("eclipse-zenoh").split(".")[:2])
        return Versions(metadata.version("fovea"), zenoh, envelope.VERSION)


class Nothing(ControlMessage, frozen=True):
    """A question without particulars."""


class About(ControlMessage, frozen=True):
    """Who an agent is."""

    label: str
    versions: Versions
    graphs: tuple[str, ...]


class Prepare(ControlMessage, frozen=True):
    """May this plan run here? Nothing is started. Answered by `Prepared`."""

    plan: Plan
    versions: Versions
    fingerprints: dict[str, str]  # node.output -> fingerprint of its message
    replace: bool = False


class Prepared(ControlMessage, frozen=True):
    """It may; the processes with an edge to another host will listen there."""

    endpoints: dict[str, str]
    weights: tuple[str, ...] = ()  # checksums that are allowed here but not there yet


class Start(ControlMessage, frozen=True):
    """Run your part of the plan; answered by `Accepted`."""

    plan: Plan
    versions: Versions
    fingerprints: dict[str, str]  # as it was prepared for
    endpoints: dict[str, str]  # of all processes that listen
    hosts: dict[str, str]  # label -> end point of its agent
    identity: str = ""  # of the graph, where nodes came and went since; else its plan tells


class Named(ControlMessage, frozen=True):
    """A question about one graph."""

    graph: str


class Lines(ControlMessage, frozen=True):
    """The end of a node's log."""

    graph: str
    node: str
    count: int = 40


class Log(ControlMessage, frozen=True):
    """Its lines."""

    lines: tuple[str, ...]


class ToNode(ControlMessage, frozen=True):
    """A question to a node, as it would be asked on the node's own host; `Relayed` back."""

    graph: str
    node: str
    question: NodeQuestion


class Relayed(ControlMessage, frozen=True):
    """What a node or the supervisor there answered: a message of that conversation."""

    payload: bytes


class Lacks(ControlMessage, frozen=True):
    """Which of these weights are allowed there and not there yet? Answered by `Missing`."""

    digests: tuple[str, ...]


class Missing(ControlMessage, frozen=True):
    """The checksums of those."""

    digests: tuple[str, ...]


class Accepted(ControlMessage, frozen=True):
    """It was done."""

    what: str = ""  # the checksum of weights that were kept


class Change(ControlMessage, frozen=True):
    """A node is to be swapped; what its supervisor says is `Relayed` back."""

    graph: str
    order: SwapOrder


class TapQuestion(ControlMessage, frozen=True):
    """What did an output send since this was asked before? Answered by `TapMessages`."""

    graph: str
    node: str
    output: str
    tap: str  # a name of the asker's choice


class TapMessages(ControlMessage, frozen=True):
    """What it sent, as descriptors; pictures stay where they are."""

    heard: tuple[tuple[int, bytes], ...]  # when it came by this host's clock, the descriptor
    skipped: int  # for want of room, since the tap was opened
    now_ns: int  # by this host's clock
    ahead_ns: dict[str, int]  # by label: what to add to this host's time


class Planned(ControlMessage, frozen=True):
    """What a host was asked to run; the answer to `Named`."""

    plan: Plan
    revision: int  # of what runs


class PlanChange(ControlMessage, frozen=True):
    """Nodes of a host, and edges between them, are to come or go; the result is `Relayed` back."""

    graph: str
    plan: Plan
    versions: Versions
    fingerprints: dict[str, str]  # of outputs that new edges begin at
    revision: int


class Ping(ControlMessage, frozen=True):
    """Sent at this time of the sender's clock."""

    sent_ns: int


class Pong(ControlMessage, frozen=True):
    """When the ping was sent and came, and when this left, the latter two by the other clock."""

    sent_ns: int
    came_ns: int
    left_ns: int


class Accounts(ControlMessage, frozen=True):
    """One host's half of the accounts of the edges that cross: edge -> counters in fixed order."""

    number: int  # rises with every message of one start
    fingerprint: str  # of the graph that runs there: another one has other edges
    ready: bool  # every process there has opened its operators
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
    crashes: int  # ends that were not asked for


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


class EdgeState(Part, frozen=True):
    """An edge as the host of its reader sees it."""

    origin: str
    end: str
    account: dict[str, Any]
    age_ms: dict[str, float]
    age_error_ms: float
    broken: bool
    sent: int


class HostState(Part, frozen=True):
    """Another host as this one sees it."""

    label: str
    lost: bool
    lost_for_s: float
    losses: int
    clock_ahead_ms: float
    clock_error_ms: float  # 0: not known yet
    round_trip_ms: float


class State(Part, frozen=True):
    """A part of a graph on one host."""

    graph: str
    label: str
    at_ns: int  # when, by the host's clock
    phase: str  # starting | running | failed | stopped
    failure: str
    processes: tuple[Process, ...]
    nodes: tuple[NodeState, ...]
    edges: tuple[EdgeState, ...]
    hosts: tuple[HostState, ...]
    network_bytes: dict[str, tuple[int, int]]  # interface -> received, sent; of the whole host


class States(ControlMessage, frozen=True):
    """The parts of graphs on one host."""

    states: tuple[State, ...]
