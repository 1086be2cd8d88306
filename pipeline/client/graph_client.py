"""Interface to a running graph, local or deployed: questions and orders."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pipeline.bus.tap import Heard, Tap
from pipeline.errors import Busy, RunError
from pipeline.graph.editing import PortTypes, rewired, with_nodes, without_node
from pipeline.graph.loader import Sent
from pipeline.graph.plan import Plan, no_output
from pipeline.protocol.codec import decode_answer
from pipeline.protocol.fleet import State
from pipeline.protocol.orders import SwapOrder, SwapResult, TopologyResult
from pipeline.protocol.questions import (
    Command,
    ConfigQuestion,
    Health,
    Interface,
    NodeQuestion,
    NodeSettings,
    Outcome,
    SchemaQuestion,
)
from pipeline.settings import suggest

FREE_S = 20.0  # for another order to end: a node that joins takes seconds
RETRY_S = 0.2
ORDER_S = 300.0  # covers loading a model, a shadow run and probation
Said = Sequence[State] | str  # of one host: its state, or why it is unknown
Edit = Callable[[Plan], Plan]
T = TypeVar("T")


def when_free(change: Callable[[], T], wait_s: float = FREE_S) -> T:
    """Return what a change returns; while its graph is busy with another one, try again."""
    late_s = time.monotonic() + wait_s
    while True:
        try:
            return change()
        except Busy:
            if time.monotonic() > late_s:
                raise
            time.sleep(RETRY_S)


class Status(msgspec.Struct, kw_only=True):
    """The status of a graph, as `ps` and `top` show it."""

    graph: str
    hosts: dict[str, Said]  # by label; the label of a local graph is empty
    nodes: dict[str, str]  # node -> label, as started


class Stopped(msgspec.Struct, kw_only=True):
    """The outcome of stopping a graph."""

    graph: str
    stopped: bool = True  # False: it had ended before
    exit_status: int | None = None  # of a detached run; None: not known
    report: str = ""  # path of a detached run's report


class Listener(ABC):
    """A tap on one output of a running graph; a context in which it listens."""

    graph: str
    output: str  # as given: node or node.output
    tap: Tap

    @abstractmethod
    def __enter__(self) -> "Listener": ...

    @abstractmethod
    def __exit__(self, *_: object) -> None: ...

    def age_ns(self, heard: Heard) -> int | None:
        """Return the exposure's age when its message arrived; None if its clock is not known."""
        return heard.at_ns - heard.header.stamp_ns

    @abstractmethod
    def over(self) -> str:
        """Return why no more messages will come, as a sentence; empty while they may."""


class GraphClient(ABC):
    """One running graph. Every method raises `FoveaError` with the reason when it fails.

    No code of the graph is imported: its running processes are asked.
    """

    name: str

    @abstractmethod
    def nodes(self) -> tuple[str, ...]:
        """The names of the nodes."""

    @abstractmethod
    def runs(self) -> bool:
        """Whether the run that was found still exists."""

    @abstractmethod
    def ask(self, node: str, question: NodeQuestion) -> bytes:
        """Return a node's reply; raises `RunError` for an unknown node or a timeout."""

    @abstractmethod
    def health(self) -> dict[str, Health | None]:
        """Return every node's health; None where the node or its host does not answer."""

    @abstractmethod
    def status(self) -> Status:
        """Return the status that `ps` and `top` show."""

    @contextmanager
    def watching(self) -> Iterator[Callable[[], Status]]:
        """Yield a function that returns the current status."""
        yield self.status

    @abstractmethod
    def swap(self, order: SwapOrder) -> SwapResult:
        """Replace a node."""

    @abstractmethod
    def replan(self, edit: Edit) -> TopologyResult:
        """Apply an edit to the plan of the graph."""

    @abstractmethod
    def stop(self) -> Stopped:
        """Stop the graph as one Ctrl-C would, and wait until it has ended."""

    @abstractmethod
    def logs(self, node: str, lines: int, *, follow: bool = False) -> Iterator[str]:
        """Yield the last lines of a node's log, then new ones if `follow`."""

    @abstractmethod
    def listen(self, output: str) -> Listener:
        """Return a tap on `node` or `node.output`; raises `RunError` for an unknown output."""

    def schema(self, node: str) -> Interface:
        """Return a node's inputs, outputs, settings and commands."""
        return self._answer(Interface, node, SchemaQuestion())

    def configure(self, node: str, changes: Mapping[str, Any]) -> NodeSettings:
        """Change live settings, or none; return the current settings and which of them are live."""
        return self._answer(NodeSettings, node, ConfigQuestion(dict(changes)))

    def command(self, node: str, command: str, arguments: Mapping[str, Any]) -> Outcome:
        """Call a command of a node."""
        return self._answer(Outcome, node, Command(command, dict(arguments)))

    def add(self, file: Path) -> TopologyResult:
        """Add the nodes of a file."""
        return self.replan(lambda plan: with_nodes(plan, file, self.ports))

    def remove(self, node: str) -> TopologyResult:
        """Remove a node whose outputs nobody reads."""
        return self.replan(lambda plan: without_node(plan, node))

    def rewire(self, wire: str) -> TopologyResult:
        """Connect an input to another output: `node.input=source.output`."""
        return self.replan(lambda plan: rewired(plan, wire, self.ports))

    def ports(self, node: str) -> PortTypes:
        """Return the message types of a node's inputs and outputs."""
        found = self.schema(node)
        inputs, outputs = (
            {name: Sent(port.message, port.fingerprint) for name, port in ports.items()}
            for ports in (found.inputs, found.outputs)
        )
        return PortTypes(inputs, outputs)

    def _answer(self, kind: type[T], node: str, question: NodeQuestion) -> T:
        return decode_answer(kind, self.ask(node, question))

    def check_node(self, node: str) -> None:
        """Raise `RunError` for an unknown node."""
        if node not in (names := self.nodes()):
            raise RunError(f"{self.name}: no node {node}{suggest(node, names)}")


def output_of(client: GraphClient, output: str) -> tuple[str, str, str]:
    """Return node, port and schema of `node` or `node.output`; raises `RunError` if unknown."""
    node, _, port = output.partition(".")
    client.check_node(node)
    outputs = client.schema(node).outputs
    port = port or "out"
    if port not in outputs:
        raise RunError(f"{client.name}: {no_output(output, outputs)}")
    return node, port, outputs[port].schema
