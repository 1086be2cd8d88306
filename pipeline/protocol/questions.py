"""Client to node: the four questions that every node answers, each below a key of the node's own.

@schema    what it takes and returns, how it can be set and told
@health    how it is; answered by the transport's thread, so also by a node that hangs
@config    its settings, and a change of live ones
@command   something to be done
"""

from typing import Any

from pipeline.protocol.codec import ControlMessage, Kind, Part

SCHEMA, HEALTH, CONFIG, COMMAND = "@schema", "@health", "@config", "@command"


class SchemaQuestion(ControlMessage, frozen=True):
    """Answered by an `Interface`."""


class HealthQuestion(ControlMessage, frozen=True):
    """Answered by a `Health`."""


class ConfigQuestion(ControlMessage, frozen=True):
    """Change these live settings, or none; answered by `NodeSettings` or `Refused`."""

    changes: dict[str, Any] = {}


class Command(ControlMessage, frozen=True):
    """Do something; answered by an `Outcome` or `Refused`."""

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
    fingerprint: str  # of the message's fields, types and shapes
    keep: str = ""  # of an input
    schema: str = ""  # the fields and types that the fingerprint stands for


class Interface(ControlMessage, frozen=True, kw_only=True):
    """What a node takes and returns, and how it can be set and told."""

    node: str
    operator: str
    settings: dict[str, Any]  # JSON Schema
    live: tuple[str, ...]
    commands: dict[str, dict[str, Any]]  # JSON Schema of the arguments
    inputs: dict[str, Port]
    outputs: dict[str, Port]


class Health(ControlMessage, frozen=True, kw_only=True):
    """The state of a node, from its accounts alone."""

    node: str
    process: str
    host: str
    pid: int
    epoch: int  # which instance this is
    state: str
    problem: str  # one sentence; empty while all is well
    handled: int  # messages, by all instances together
    last_seq: int
    busy_s: float  # with the message in hand, 0 without one
    silent_s: float  # since its last heartbeat
    own_mb: float  # memory of its process that it shares with nobody
    words: str  # the operator's headline
    waiting: dict[str, int]  # messages under way, by input
    dropped: dict[str, dict[str, int]]  # by input and reason
    broken: tuple[str, ...]  # outputs' edges on which a lossless reader lost something


class NodeSettings(ControlMessage, frozen=True, kw_only=True):
    """The effective values of a node's settings."""

    settings: dict[str, Any]
    live: tuple[str, ...]  # which of them can change while it runs


class Outcome(ControlMessage, frozen=True, kw_only=True):
    """What a command returned."""

    answer: dict[str, Any] = {}
