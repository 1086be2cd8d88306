"""Connect the operators of a process: nodes and edges to runners, ports, sockets and keys."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from pipeline.bus.clocks import Clocks
from pipeline.bus.inport import InPort
from pipeline.bus.ledger import Ledger, private_ledger
from pipeline.bus.local_transport import LocalReceiver, LocalSender
from pipeline.bus.outport import BYTES_SUFFIX, Arrival, OutPort, Reader
from pipeline.bus.pool import PoolReader, PoolWriter
from pipeline.bus.pool_tap import PoolTap
from pipeline.bus.session import Sender, Session
from pipeline.contract import Input, Operator, Source, outputs_of
from pipeline.graph.plan import Edge, Node, Plan, inputs_for, slots
from pipeline.node.answers import Answers
from pipeline.node.handover import HANDOVER_CHANNEL, Handover, Say
from pipeline.node.live import Live, kept
from pipeline.node.operator_runner import OperatorRunner
from pipeline.node.shadow import MOST_WAITING, Heard
from pipeline.node.source import SourceRunner
from pipeline.private_folder import PrivateFolder
from pipeline.protocol.supervision import Assignment, Replanned

CLOCKS = "clocks"  # file of clock offsets in the run's folder
ASIDE = "--aside"  # argument of a process that nothing waits for yet


class Wiring:
    """The connections of a process; `close` releases everything."""

    def __init__(
        self, job: Assignment, session: Session, ledger: Ledger, say: Say,
        border: Session | None = None,
    ) -> None:  # fmt: skip
        self._job, self._session, self._ledger, self._say = job, session, ledger, say
        self._border = border  # the session with other hosts
        self._clocks = clocks_of(job)
        self._memory = PrivateFolder(Path(job.memory_folder))
        self._receivers: list[LocalReceiver] = []
        self._senders: list[LocalSender] = []
        self._stops: list[Any] = []
        self.handovers: dict[str, Handover] = {}
        self._running: dict[str, tuple[OperatorRunner, LocalReceiver, Answers]] = {}

    def close(self) -> None:
        """Stop listening and close every socket."""
        for stop in self._stops:
            stop()
        for sender in self._senders:
            sender.close()
        for receiver in self._receivers:
            receiver.close()

    def runner(self, node: Node, operator: Operator[Any, Any]) -> OperatorRunner:
        """Return the runner of an operator, with open receiver and connected ports."""
        job, plan = self._job, self._job.plan
        edges = plan.inputs(node.name)
        receiver = LocalReceiver(job.receiver(node.name, job.epochs[node.name]))
        self._receivers.append(receiver)
        outs = {
            name: self._out_port(node, name, message)
            for name, message in outputs_of(type(operator)).items()
        }
        common: dict[str, Any] = {
            "inputs": inputs_for(plan, node),
            "edges": {name: self._ledger.edges[e.index] for name, e in edges.items()},
            "outs": outs,
            "receiver": receiver,
            "account": self._ledger.nodes[node.index],
            "lockstep": plan.clock == "lockstep",
            "epoch": job.epochs[node.name],
        }
        runner = (
            SourceRunner(
                node.name, operator, drained=self._ledger.drained, limit=job.frames, **common
            )
            if isinstance(operator, Source)
            else OperatorRunner(node.name, operator, **common)
        )
        runner.clocks = self._clocks
        live = Live(node.name, operator, settings_of(job, node), live_file(job, node))
        answers = Answers(plan, node, operator, runner, live, self._ledger)
        key = partial(key_of, plan.name, node.name)
        queryables = _Queryables(lambda: answers.serve(self._session, key))
        self._stops.append(queryables.undeclare)
        self._running[node.name] = (runner, receiver, answers)
        for edge in edges.values():
            self._listen(runner, edge, common["inputs"][edge.input], receiver)
        if swappable(plan, node) and not isinstance(operator, Source):
            handover = Handover(
                runner, memory=self._memory, say=self._say,
                queryables=queryables, listen=partial(self._tap, node, type(operator)),
                standby=job.standby,
            )  # fmt: skip
            runner.handover = self.handovers[node.name] = handover
            receiver.expect(HANDOVER_CHANNEL, handover.receive)
        if not job.standby:
            queryables.declare()
        return runner

    def replan(self, node: str, plan: Plan) -> None:
        """Reconnect a running node by another plan; operator and settings stay."""
        self._job = msgspec.structs.replace(self._job, plan=plan)
        runner, receiver, answers = self._running[node]
        answers.plan = plan
        declared = inputs_for(plan, plan.node(node))
        for edge in plan.inputs(node).values():
            if runner.edges[edge.input] is not self._ledger.edges[edge.index]:
                port = self._in_port(runner, edge, declared[edge.input])
                runner.rewire(edge.input, self._ledger.edges[edge.index], port)
                receiver.expect(edge.index, port.receive)
        for output, port_out in runner.outs.items():
            edges = plan.readers(node, output)
            port_out.change_readers(self._readers(edges), slots(edges))
        self._say(Replanned(node))

    def _readers(self, edges: tuple[Edge, ...]) -> list[Reader]:
        return [
            Reader(
                self._ledger.edges[e.index], self._job.plan.lossless(e), e.depth + 1, e.index,
                partial(self._job.receiver, e.target) if e.transport == "pool" else None,
            )
            for e in edges
        ]  # fmt: skip

    def _out_port(self, node: Node, output: str, message: type[Any]) -> OutPort:
        job = self._job
        edges = job.plan.readers(node.name, output)
        readers = self._readers(edges)
        key = key_of(job.plan.name, node.name, output)
        urgent = any(e.command for e in edges)
        patient = any(e.transport == "bytes" and job.plan.lossless(e) for e in edges)
        stem = f"{node.name}.{output}"
        sender = LocalSender()
        self._senders.append(sender)
        return OutPort(
            message,
            sender,
            self._session.sender(key, urgent=urgent),
            self._remote(key + BYTES_SUFFIX, edges, urgent=urgent, patient=patient),
            readers,
            lambda claim: PoolWriter(self._memory, stem, slots(edges), claim),
            job.epochs[node.name],
        )

    def _tap(
        self, node: Node, operator: type[Operator[Any, Any]], heard: Heard
    ) -> Callable[[], None]:
        """Tap the outputs of another instance of a node."""
        stops = []
        for name, message in outputs_of(operator).items():
            pool = PoolTap(self._memory, f"{node.name}.{name}")
            port = InPort(
                message, private_ledger(1, 0).edges[0], pool, 1, partial(_hear, heard, name),
                tap=True,
            )  # fmt: skip
            key = key_of(self._job.plan.name, node.name, name)
            stops.append(self._session.listen(key, port.receive))

        def stop() -> None:
            while stops:
                stops.pop()()

        return stop

    def _in_port(
        self, runner: OperatorRunner, edge: Edge, declared: Input, *, holding: bool = False
    ) -> InPort:
        port = InPort(
            declared.message,
            self._ledger.edges[edge.index],
            PoolReader(self._memory, f"{edge.source}.{edge.output}"),
            runner.epoch,
            partial(runner.deliver, edge.input),
            tap=edge.tap,
            holding=holding,
        )
        port.on_loss = partial(runner.lost, edge.input)
        return port

    def _listen(
        self, runner: OperatorRunner, edge: Edge, declared: Input, receiver: LocalReceiver
    ) -> None:
        job = self._job
        port = self._in_port(runner, edge, declared, holding=job.standby)
        runner.ports[edge.input] = port
        if edge.transport == "pool":
            receiver.expect(edge.index, port.receive)
            return
        key = key_of(job.plan.name, edge.source, edge.output) + BYTES_SUFFIX
        session = self._border if self._border and job.plan.crosses(edge) else self._session
        self._stops.append(session.listen(key, port.receive))

    def _remote(self, key: str, edges: tuple[Edge, ...], *, urgent: bool, patient: bool) -> Sender:
        """Return the sender of complete messages: to other hosts if needed, and on this one."""
        here = self._session.sender(key, urgent=urgent, patient=patient)
        if self._border is None or not any(self._job.plan.crosses(e) for e in edges):
            return here
        # not a patient one: Zenoh closes a link that blocks such a sender, and does it twice, so
        # that it also closes the link's successor
        return _Both(here, self._border.sender(key, urgent=urgent))


def _hear(heard: Heard, name: str, arrival: Arrival) -> None:
    if heard.qsize() < MOST_WAITING:
        heard.put((name, arrival))


class _Queryables:
    """The answers of a node, which can be switched on and off."""

    def __init__(self, serve: Callable[[], list[Callable[[], None]]]) -> None:
        self._serve = serve
        self._stops: list[Callable[[], None]] = []

    def declare(self) -> None:
        """Start answering."""
        self._stops = self._serve()

    def undeclare(self) -> None:
        """Stop answering."""
        while self._stops:
            self._stops.pop()()


def swappable(plan: Plan, node: Node) -> bool:
    """Whether a node can have a standby: no shared process, no edge outside the local transport.

    Only the local transport preserves the order across a change of the sender.
    """
    alone = sum(1 for n in plan.nodes if n.process == node.process) == 1
    return alone and not any(
        e.transport == "bytes" for e in plan.edges if node.name in (e.source, e.target)
    )


class _Both:
    """Two senders of one key, on two sessions."""

    def __init__(self, *senders: Sender) -> None:
        self._senders = senders

    def send(self, payload: bytes) -> None:
        for sender in self._senders:
            if sender.matching():
                sender.send(payload)

    def matching(self) -> bool:
        return any(sender.matching() for sender in self._senders)


def live_file(job: Assignment, node: Node) -> Path:
    """Return the file of settings that were changed at run time."""
    return Path(job.run_folder) / f"{node.name}.live"


def settings_of(job: Assignment, node: Node) -> dict[str, Any]:
    """Return the plan's settings with changes at run time.

    For a standby, the plan already contains both and the changes by the swap.
    """
    return {**node.settings, **({} if job.standby else kept(live_file(job, node)))}


def clocks_of(job: Assignment) -> Clocks:
    """Return the clocks of the hosts of a run, or only this host's."""
    plan = job.plan
    if not plan.here:
        return Clocks()
    return Clocks.open(Path(job.run_folder) / CLOCKS, plan.here, plan.hosts)


def key_of(graph: str, node: str, output: str) -> str:
    """Return the Zenoh key of an output."""
    return f"fovea/{graph}/{node}/{output}"
