"""Run a graph in one thread, deterministically, without Zenoh: for tests, training, evaluation.

Every frame passes the whole graph before the next exposure, in dependency order; unjoined inputs
are handled after the joined set, as in a lockstep run of processes. Messages are checked as for
sending, and their arrays are read-only for readers.
"""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from typing import Any

from pipeline import settings as checked
from pipeline.bus.inbox import Inbox, Work
from pipeline.bus.ledger import Ledger, private_ledger
from pipeline.bus.outport import Arrival
from pipeline.contract import Operator, Source, outputs_of, settings_of
from pipeline.errors import GraphError, RunError
from pipeline.executor import Answers, Executor, carried, header_of, open_operator
from pipeline.graph.plan import Edge, Node, Plan, inputs_for, load_operator
from pipeline.messages import Header, Message, Span, altered, stamped
from pipeline.node.live import Live
from pipeline.node.source import fold
from pipeline.run.report import Report, compose

Watch = Callable[[str, Message], None]  # node.output, message


class _InlineNode:
    """One operator of the graph."""

    def __init__(self, plan: Plan, node: Node, ledger: Ledger, played: Executor | None) -> None:
        cls = load_operator(node.operator)
        self.node = node
        self.operator: Operator[Any, Any] = (
            played.operator
            if played
            else cls(checked.build(settings_of(cls), node.settings, node.name))
        )
        self.live = Live(node.name, self.operator, {} if played else node.settings, None)
        self.edges = plan.inputs(node.name)
        self.account = ledger.nodes[node.index]
        self.outputs = tuple(outputs_of(cls))
        self.executor = played or Executor(node.name, self.operator)
        accounts = {name: ledger.edges[e.index] for name, e in self.edges.items()}
        self.inbox = Inbox(
            inputs_for(plan, node),
            lambda name, outcome, _ordinal: accounts[name].acknowledge(outcome),
            lockstep=True,
        )


class InlineRunner:
    """Opens a plan's operators in this process; use as a context."""

    def __init__(
        self,
        plan: Plan,
        *,
        watch: Watch | None = None,
        played: Mapping[str, Executor] | None = None,
    ) -> None:
        """`played`: what stands for a node that does not run, by its name."""
        self.plan, self._watch = plan, watch
        self.ledger = private_ledger(len(plan.edges), len(plan.nodes))
        self._nodes = {
            name: _InlineNode(plan, plan.node(name), self.ledger, (played or {}).get(name))
            for name in plan.order()
        }
        self._source = self._only_source()
        self.commands = hashlib.sha256()
        self.at = ""  # the node whose code is running
        self.exposure = "", 0  # stream and seq of the latest frame
        self.began = False  # whether every operator was opened
        self._began_s = time.monotonic()

    def __enter__(self) -> "InlineRunner":
        assert isinstance(self._source.operator, Source)
        self._source.operator.realtime = False
        try:
            for name, loaded in self._nodes.items():
                self.at = name
                open_operator(name, loaded.operator)
                loaded.account.provider = str(loaded.operator.runs_on())
        except BaseException:
            self.__exit__()
            raise
        self.began = True
        self._began_s = time.monotonic()  # the rate excludes loading networks
        return self

    def __exit__(self, *_: object) -> None:
        """Close every operator, even if one fails to close; the first error is raised."""
        with ExitStack() as closing:
            for loaded in self._nodes.values():  # in reverse order
                closing.callback(self._close, loaded)

    def _close(self, loaded: _InlineNode) -> None:
        at, self.at = self.at, loaded.node.name
        loaded.operator.close()
        self.at = at

    def operator(self, node: str) -> Operator[Any, Any]:
        """Return the operator of a node, for training and evaluation."""
        return self._nodes[node].operator

    def change(self, node: str, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Change live settings between two frames; return all current settings.

        Raises `SettingsError` and changes nothing when refused, `RunError` for an unknown node.
        """
        if node not in self._nodes:
            raise RunError(f"{self.plan.name}: no node {node}{checked.suggest(node, self._nodes)}")
        live = self._nodes[node].live
        live.change(changes)
        return live.describe().settings

    def run(self, frames: int = 0) -> Iterator[int]:
        """Run up to `frames` frames (0: all), yielding each seq once the graph has finished it."""
        count = 0
        while not frames or count < frames:
            begun, self.at = time.monotonic_ns(), self._source.node.name
            exposed = self._source.executor.produce()
            if exposed is None:
                return
            self._source.account.histograms["handler"].add(time.monotonic_ns() - begun)
            header = header_of(exposed)
            self.exposure = header.stream, header.seq
            self._send(self._source, exposed, header, begun_ns=header.stamp_ns)
            self._drain_frame()
            count += 1
            yield header.seq

    def report(self, *, summaries: bool = True) -> Report:
        """Return the report of the run, as for processes; `summaries`: ask the operators, too."""
        nodes = self._nodes.items() if summaries else ()
        found = {}
        for self.at, loaded in nodes:
            found[self.at] = dict(loaded.operator.summary())
        found.setdefault(self._source.node.name, {})["schedule_sha256"] = self.commands.hexdigest()
        duration_s = time.monotonic() - self._began_s
        return compose(self.plan, self.ledger, found, {}, duration_s=duration_s)

    def _only_source(self) -> _InlineNode:
        found = [p for p in self._nodes.values() if isinstance(p.operator, Source)]
        if len(found) != 1:
            expected = f"{self.plan.name}: expected one node that makes frames"
            names = ", ".join(loaded.node.name for loaded in found)
            remedy = f": {names}; several run as processes, without --inline" if names else ""
            raise GraphError(f"{expected}, got {len(found)}{remedy}")
        return found[0]

    def _drain_frame(self) -> None:
        """Handle everything that was sent."""
        pending = True
        while pending:
            pending = False
            for loaded in self._nodes.values():
                work = loaded.inbox.take(time.monotonic_ns())
                while work is not None:
                    pending = True
                    self._handle(loaded, work)
                    work = loaded.inbox.take(time.monotonic_ns())
        if not self.ledger.drained():
            stuck = [e.end for e in self.plan.edges if self.ledger.edges[e.index].in_flight]
            raise RunError(f"frame not answered: messages wait at {', '.join(stuck)}")

    def _handle(self, loaded: _InlineNode, work: Work) -> None:
        begun, self.at = time.monotonic_ns(), loaded.node.name
        if work.new_stream:
            loaded.operator.on_stream(work.header)
        names = tuple(work.messages)
        answers: Answers = {}
        if work.answer:
            answers = loaded.executor.call(work.messages)
            if loaded.edges[names[0]].command:
                message = work.messages[names[0]]
                assert message is not None
                fold(self.commands, message)
        loaded.account.handled += 1
        if loaded is not self._source:  # for a source, the exposure counts as the handler
            loaded.account.histograms["handler"].add(time.monotonic_ns() - begun)
        if not loaded.executor.is_side(names):
            self._send(loaded, answers, work.header, begun_ns=begun)
        for name in work.arrived:
            self.ledger.edges[loaded.edges[name].index].delivered += 1

    def _send(
        self, loaded: _InlineNode, answers: Answers, header: Header, *, begun_ns: int
    ) -> None:
        node, now = loaded.node.name, time.monotonic_ns()
        span = Span(
            stage=node,
            received_ns=begun_ns,
            done_ns=now,
            handler_ns=now - begun_ns,
            scheduling_delay_ns=0,
        )
        leaving = stamped(header, epoch=1, span=span)
        for output in loaded.outputs:
            message = answers.get(output)
            if message is not None:
                message = carried(altered(message, header=leaving), f"{node}.{output}")
                if self._watch:
                    self._watch(f"{node}.{output}", message)
            for edge in self.plan.readers(node, output):
                self._hand_over(edge, leaving, message)

    def _hand_over(self, edge: Edge, header: Header, message: Message | None) -> None:
        account = self.ledger.edges[edge.index]
        account.sent += 1
        arrival = Arrival(header, message, account.sent)
        self._nodes[edge.target].inbox.offer(edge.input, arrival, time.monotonic_ns())
        account.seen = account.sent
