"""Messages from client to node: four questions, each with a key below the node's own.

@schema    its inputs, outputs, settings and commands
@health    its state; answered by the transport's thread, so even by a node that hangs
@config    its settings, and changes of live ones
@command   a call of one of its commands
"""

from typing import Any

from pipeline.protocol.codec import ControlMessage, Kind, Part

SCHEMA, HEALTH, CONFIG, COMMAND = "@schema", "@health", "@config", "@command"


class SchemaQuestion(ControlMessage, frozen=True):
    """Answered by an `Interface`."""


class HealthQuestion(ControlMessage, frozen=True):
    """Answered by a `Health`."""


class ConfigQuestion(ControlMessage, frozen=True):
    """Change live settings, or none; answered by `NodeSettings` or `Refused`."""

    changes: dict[str, Any] = {}


class Command(ControlMessage, frozen=True):
    """Call a command; answered by an `Outcome` or `Refused`."""

    command: str
    arguments: dict[str, Any] = {}


NodeQuestion = SchemaQuestion | HealthQuestion | ConfigQuestion | Command
KEYS: dict[type[NodeQuestion], str] = {
    SchemaQuestion: SCHEMA, HealthQuestion: HEALTH, ConfigQuestion: CONFIG, Command: COMMAND,
}  # fmt: skip
QUESTION: Kind[NodeQuestion] = Kind("a question to a node", NodeQuestion)


class Port(Part, frozen=True):
    """An input or an output."""

    message: str
    fingerprint: str  # of the message's schema
    keep: str = ""  # of an input
    schema: str = ""  # the text behind the fingerprint


class Interface(ControlMessage, frozen=True, kw_only=True):
    """A node's inputs, outputs, settings and commands."""

    node: str
    operator: str
    settings: dict[str, Any]  # JSON Schema
    live: tuple[str, ...]
    commands: dict[str, dict[str, Any]]  # JSON Schema of the arguments
    inputs: dict[str, Port]
    outputs: dict[str, Port]


class Health(ControlMessage, frozen=True, kw_only=True):
    """The health of a node, from its accounts alone."""

    node: str
    process: str
    host: str
    pid: int
    epoch: int  # number of the instance
    state: str
    problem: str  # one sentence; empty if healthy
    handled: int  # messages, of all instances
    last_seq: int
    busy_s: float  # time in the current handler call, 0 if idle
    silent_s: float  # since its last heartbeat
    own_mb: float  # private memory of its process
    words: str  # the operator's headline
    waiting: dict[str, int]  # messages in flight, by input
    dropped: dict[str, dict[str, int]]  # by input and reason
    broken: tuple[str, ...]  # edges on which a lossless reader lost messages


class NodeSettings(ControlMessage, frozen=True, kw_only=True):
    """The effective values of a node's settings."""

    settings: dict[str, Any]
    live: tuple[str, ...]  # which of them can change while it runs


class Outcome(ControlMessage, frozen=True, kw_only=True):
    """What a command returned."""

    answer: dict[str, Any] = {}
