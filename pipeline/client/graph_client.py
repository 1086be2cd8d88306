"""What can be asked of a running graph and what it can be told, wherever it runs."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pipeline.bus.tap import Heard, Tap
from pipeline.errors import RunError
from pipeline.graph.editing import PortTypes, rewired, with_nodes, without_node
from pipeline.graph.loader import Sent
from pipeline.graph.plan import Plan
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

ORDER_S = 300.0  # loading a model, a shadow run and probation take their time
Said = Sequence[State] | str  # of one host: what runs there, or why that is not known
Edit = Callable[[Plan], Plan]
T = TypeVar("T")


class Status(msgspec.Struct, kw_only=True):
    """A graph as `ps` and `top` show it."""

    graph: str
    hosts: dict[str, Said]  # by label; that of a graph which runs here alone is empty
    nodes: dict[str, str]  # node -> label, as it was started


class Stopped(msgspec.Struct, kw_only=True):
    """What became of a graph that was told to stop."""

    graph: str
    stopped: bool = True  # False: it had ended before
    exit_status: int | None = None  # of a run that was detached; None: it is not known
    report: str = ""  # the file with the report of a run that was detached


class Listener(ABC):
    """A tap on one output of a running graph. Use it as a context: it hears meanwhile."""

    graph: str
    output: str  # as it was named: node or node.output
    tap: Tap

    @abstractmethod
    def __enter__(self) -> "Listener": ...

    @abstractmethod
    def __exit__(self, *_: object) -> None: ...

    def age_ns(self, heard: Heard) -> int | None:
        """How old an exposure was when its message came; None while its clock is not known."""
        return heard.at_ns - heard.header.stamp_ns

    @abstractmethod
    def over(self) -> str:
        """Why nothing more will come, in a sentence; empty while something may."""


class GraphClient(ABC):
    """One running graph. Every method raises `FoveaError` with the reason when it cannot be done.

    Nothing of the graph's own code is loaded: the running processes are asked.
    """

    name: str

    @abstractmethod
    def nodes(self) -> tuple[str, ...]:
        """The names of its nodes."""

    @abstractmethod
    def runs(self) -> bool:
        """Whether it is still the run that was found."""

    @abstractmethod
    def ask(self, node: str, question: NodeQuestion) -> bytes:
        """One node's answer or refusal; raises `RunError` for no such node, or for silence."""

    @abstractmethod
    def health(self) -> dict[str, Health | None]:
        """What every node says; None for one that is silent, or whose host is."""

    @abstractmethod
    def status(self) -> Status:
        """What `ps` and `top` show."""

    @contextmanager
    def watching(self) -> Iterator[Callable[[], Status]]:
        """A way to look again and again."""
        yield self.status

    @abstractmethod
    def swap(self, order: SwapOrder) -> SwapResult:
        """Replace a node."""

    @abstractmethod
    def replan(self, edit: Edit) -> TopologyResult:
        """Have it become what `edit` makes of its plan."""

    @abstractmethod
    def stop(self) -> Stopped:
        """End it as one Ctrl-C would, and wait for that."""

    @abstractmethod
    def logs(self, node: str, lines: int, *, follow: bool = False) -> Iterator[str]:
        """The last lines of a node's log, then what is added."""

    @abstractmethod
    def listen(self, output: str) -> Listener:
        """A tap on `node` or `node.output`; raises `RunError` for an output that does not exist."""

    def schema(self, node: str) -> Interface:
        """What a node takes and gives, its settings and its commands."""
        return self._answer(Interface, node, SchemaQuestion())

    def configure(self, node: str, changes: Mapping[str, Any]) -> NodeSettings:
        """Change live settings, or none; the settings that hold now, and which of them are live."""
        return self._answer(NodeSettings, node, ConfigQuestion(dict(changes)))

    def command(self, node: str, command: str, arguments: Mapping[str, Any]) -> Outcome:
        """Have a node do something."""
        return self._answer(Outcome, node, Command(command, dict(arguments)))

    def add(self, file: Path) -> TopologyResult:
        """Add the nodes of a file."""
        return self.replan(lambda plan: with_nodes(plan, file, self.ports))

    def remove(self, node: str) -> TopologyResult:
        """Remove a node that nobody reads."""
        return self.replan(lambda plan: without_node(plan, node))

    def rewire(self, wire: str) -> TopologyResult:
        """Connect an input elsewhere: `node.input=source.output`."""
        return self.replan(lambda plan: rewired(plan, wire, self.ports))

    def ports(self, node: str) -> PortTypes:
        """The messages that a node takes and gives."""
        found = self.schema(node)
        inputs, outputs = (
            {name: Sent(port.message, port.fingerprint) for name, port in ports.items()}
            for ports in (found.inputs, found.outputs)
        )
        return PortTypes(inputs, outputs)

    def _answer(self, kind: type[T], node: str, question: NodeQuestion) -> T:
        return decode_answer(kind, self.ask(node, question))

    def check_node(self, node: str) -> None:
        """Raise `RunError` unless it has such a node."""
        if node not in (names := self.nodes()):
            raise RunError(f"{self.name}: no node {node}{suggest(node, names)}")


def output_of(client: GraphClient, output: str) -> tuple[str, str, str]:
    """Node, port and schema of `node` or `node.output`; raises `RunError` for one there is not."""
    node, _, port = output.partition(".")
    client.check_node(node)
    outputs = client.schema(node).outputs
    port = port or "out"
    if port not in outputs:
        options = [o if o != "out" else node for o in (f"{node}.{p}" for p in outputs)]
        hint = suggest(output, options)
        raise RunError(f"{client.name}: {node} has no output {port}{hint}")
    return node, port, outputs[port].schema
