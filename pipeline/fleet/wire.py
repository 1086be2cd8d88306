"""What is said between command line and agents, and between agents: JSON with fixed fields.

Everything that comes in is checked here for form; what it asks for is checked by who does it.
"""

from collections.abc import Callable
from functools import partial
from importlib import metadata
from typing import Any, Literal, TypeVar

import msgspec
from pydantic import ValidationError

from pipeline import codec
from pipeline.bus import envelope
from pipeline.class_cache import adapter
from pipeline.errors import MessageError, RunError
from pipeline.graph.plan import Plan
from pipeline.protocol.orders import SwapOrder

MOST_BYTES = 1 << 20  # of one question; a graph is a few kilobytes
T = TypeVar("T")


class Versions(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What has to be the same on all hosts."""

    fovea: str
    zenoh: str
    envelope: int

    @staticmethod
    def ours() -> "Versions":
        """Of this installation."""
        zenoh = ".".join(metadata.version("eclipse-zenoh").split(".")[:2])
        return Versions(metadata.version("fovea"), zenoh, envelope.VERSION)


class Nothing(msgspec.Struct, forbid_unknown_fields=True):
    """A question without particulars."""


class About(msgspec.Struct, forbid_unknown_fields=True):
    """Who an agent is."""

    label: str
    versions: Versions
    graphs: tuple[str, ...]


class Prepare(msgspec.Struct, forbid_unknown_fields=True):
    """May this plan run here? Nothing is started."""

    plan: str
    versions: Versions
    fingerprints: dict[str, str]  # node.output -> fingerprint of its message
    replace: bool = False


class Prepared(msgspec.Struct, forbid_unknown_fields=True):
    """It may; the processes with an edge to another host will listen there."""

    endpoints: dict[str, str]
    weights: tuple[str, ...] = ()  # checksums that are allowed here but not there yet


class Start(msgspec.Struct, forbid_unknown_fields=True):
    """Run your part of the plan."""

    plan: str
    versions: Versions
    fingerprints: dict[str, str]  # as it was prepared for
    endpoints: dict[str, str]  # of all processes that listen
    hosts: dict[str, str]  # label -> end point of its agent
    identity: str = ""  # of the graph, where nodes came and went since; else its plan tells


class Named(msgspec.Struct, forbid_unknown_fields=True):
    """A question about one graph."""

    graph: str


class Lines(msgspec.Struct, forbid_unknown_fields=True):
    """The end of a node's log."""

    graph: str
    node: str
    count: int = 40


class Log(msgspec.Struct, forbid_unknown_fields=True):
    """Its lines."""

    lines: tuple[str, ...]


Question = Literal["@config", "@command", "@schema", "@health"]


class ToNode(msgspec.Struct, forbid_unknown_fields=True):
    """A question to a node, as it would be asked on the node's own host."""

    graph: str
    node: str
    question: Question
    payload: bytes


class Said(msgspec.Struct, forbid_unknown_fields=True):
    """What the node answered."""

    payload: bytes


class Lacks(msgspec.Struct, forbid_unknown_fields=True):
    """Which of these weights are allowed there and not there yet?"""

    digests: tuple[str, ...]


class Change(msgspec.Struct, forbid_unknown_fields=True):
    """A node is to be swapped."""

    graph: str
    order: SwapOrder


class Listen(msgspec.Struct, forbid_unknown_fields=True):
    """What did an output send since this was asked before?"""

    graph: str
    node: str
    output: str
    tap: str  # a name of the asker's choice


class Relayed(msgspec.Struct, forbid_unknown_fields=True):
    """What it sent, as descriptors; pictures stay where they are."""

    heard: tuple[tuple[int, bytes], ...]  # when it came by this host's clock, the descriptor
    skipped: int  # for want of room, since the tap was opened
    now_ns: int  # by this host's clock
    ahead_ns: dict[str, int]  # by label: what to add to this host's time


class Planned(msgspec.Struct, forbid_unknown_fields=True):
    """What a host was asked to run."""

    plan: str
    revision: int  # of what runs


class Replan(msgspec.Struct, forbid_unknown_fields=True):
    """Nodes of a host, and edges between them, are to come or go."""

    graph: str
    plan: str
    versions: Versions
    fingerprints: dict[str, str]  # of outputs that new edges begin at
    revision: int


class Ping(msgspec.Struct, forbid_unknown_fields=True, array_like=True):
    """Sent at this time of the sender's clock."""

    sent_ns: int


class Pong(msgspec.Struct, forbid_unknown_fields=True, array_like=True):
    """When the ping was sent and came, and when this left, the latter two by the other clock."""

    sent_ns: int
    came_ns: int
    left_ns: int


class Accounts(msgspec.Struct, forbid_unknown_fields=True, array_like=True):
    """One host's half of the accounts of the edges that cross: edge -> counters in fixed order."""

    number: int  # rises with every message of one start
    fingerprint: str  # of the graph that runs there: another one has other edges
    ready: bool  # every process there has opened its operators
    written: dict[int, tuple[int, ...]]
    read: dict[int, tuple[int, ...]]


class Process(msgspec.Struct, forbid_unknown_fields=True):
    """A process as `ps` shows it."""

    name: str
    nodes: tuple[str, ...]
    pid: int
    cpu_s: float
    rss_mb: float
    restarts: int


class NodeState(msgspec.Struct, forbid_unknown_fields=True):
    """A node as `top` shows it."""

    name: str
    condition: str
    epoch: int
    handled: int
    last_seq: int
    handler_ms: dict[str, float]
    hop_ms: dict[str, float]
    loop_ms: dict[str, float]


class EdgeState(msgspec.Struct, forbid_unknown_fields=True):
    """An edge as the host of its reader sees it."""

    origin: str
    end: str
    account: dict[str, Any]
    age_ms: dict[str, float]
    age_error_ms: float
    broken: bool
    sent: int


class HostState(msgspec.Struct, forbid_unknown_fields=True):
    """Another host as this one sees it."""

    label: str
    lost: bool
    lost_for_s: float
    losses: int
    clock_ahead_ms: float
    clock_error_ms: float  # 0: not known yet
    round_trip_ms: float


class State(msgspec.Struct, forbid_unknown_fields=True):
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


class _Reply(msgspec.Struct, forbid_unknown_fields=True):
    refused: str = ""
    answer: msgspec.Raw = msgspec.Raw(b"null")


def encode(value: Any) -> bytes:
    """The bytes of any of the above."""
    return msgspec.json.encode(value)


def decode(cls: type[T], data: bytes) -> T:
    """One of the above from untrusted bytes; raises `MessageError`."""
    if len(data) > MOST_BYTES:
        raise MessageError(f"{cls.__name__}: expected up to {MOST_BYTES} bytes, got {len(data)}")
    read: Callable[[Any], T] = partial(msgspec.json.decode, type=cls)
    return codec.parse(read, data, f"not a {cls.__name__}")


def answered(value: Any) -> bytes:
    """A reply that holds what was asked for."""
    return encode(_Reply(answer=msgspec.Raw(encode(value))))


def refused(why: str) -> bytes:
    """A reply that says why not."""
    return encode(_Reply(refused=why))


def read_reply(cls: type[T], label: str, data: bytes) -> T:
    """What an agent answered; raises `RunError` with its reason when it refused."""
    reply = decode(_Reply, data)
    if reply.refused:
        raise RunError(f"{label}: {reply.refused}")
    return decode(cls, bytes(reply.answer))


def write_plan(plan: Plan) -> str:
    """A plan as text."""
    return adapter(Plan).dump_json(plan).decode()


def read_plan(text: str) -> Plan:
    """A plan from untrusted text; raises `MessageError`, or `GraphError` for names and numbers."""
    try:
        return adapter(Plan).validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise MessageError(f"not a plan: {place}: {first['msg'].lower()}") from error
