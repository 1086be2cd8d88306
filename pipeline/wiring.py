"""Connects the operators of a process: a plan's nodes and edges to hosts, ports, doors and keys."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.answers import Answers
from pipeline.bus import Session
from pipeline.contract import Input, Operator, Source, outputs_of
from pipeline.doors import Doors, Links
from pipeline.host import Host
from pipeline.ledger import Ledger
from pipeline.live import Live, kept
from pipeline.plan import Edge, Node, Plan, inputs_for, slots
from pipeline.pool import PoolReader, PoolWriter
from pipeline.ports import BYTES_SUFFIX, InPort, OutPort, Reader
from pipeline.source import SourceHost


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """What the supervisor gives a process to do."""

    plan: Plan
    process: str
    run_folder: str
    memory_folder: str
    prefix: str  # of every file of this run in the memory folder
    epochs: dict[str, int]  # by node
    frames: int = 0

    def kept_in(self, node: Node) -> Path:
        """The file of settings that were changed while the node ran."""
        return Path(self.run_folder) / f"{node.name}.live"

    def settings(self, node: Node) -> dict[str, Any]:
        """What the graph says, and what a predecessor was told since."""
        return {**node.settings, **kept(self.kept_in(node))}


class Wiring:
    """What a process holds of its graph; `close` gives everything back."""

    def __init__(self, job: Assignment, session: Session, ledger: Ledger) -> None:
        self._job, self._session, self._ledger = job, session, ledger
        self._memory = Path(job.memory_folder)
        self._doors: list[Doors] = []
        self._links: list[Links] = []
        self._stops: list[Any] = []

    def close(self) -> None:
        """Stop listening and close every socket."""
        for stop in self._stops:
            stop()
        for links in self._links:
            links.close()
        for doors in self._doors:
            doors.close()

    def host(self, node: Node, operator: Operator[Any, Any]) -> Host:
        """The host of an operator, its doors open and its ports connected."""
        job, plan = self._job, self._job.plan
        edges = plan.inputs(node.name)
        doors = Doors(self._address(node.name))
        self._doors.append(doors)
        outs = {
            name: self._out_port(node, name, message)
            for name, message in outputs_of(type(operator)).items()
        }
        common: dict[str, Any] = {
            "inputs": inputs_for(plan, node),
            "edges": {name: self._ledger.edges[e.index] for name, e in edges.items()},
            "outs": outs,
            "doors": doors,
            "account": self._ledger.nodes[node.index],
            "lockstep": plan.clock == "lockstep",
            "epoch": job.epochs[node.name],
        }
        host = (
            SourceHost(
                node.name, operator, drained=self._ledger.drained, limit=job.frames, **common
            )
            if isinstance(operator, Source)
            else Host(node.name, operator, **common)
        )
        live = Live(node.name, operator, job.settings(node), job.kept_in(node))
        answers = Answers(plan, node, operator, host, live, self._ledger)
        self._stops += answers.serve(self._session, partial(key_of, plan.name, node.name))
        for edge in edges.values():
            self._listen(host, edge, common["inputs"][edge.input], doors)
        return host

    def _out_port(self, node: Node, output: str, message: type[Any]) -> OutPort:
        job = self._job
        edges = job.plan.readers(node.name, output)
        readers = [
            Reader(self._ledger.edges[e.index], e.keep == "every", e.depth + 1, e.index)
            for e in edges
        ]
        key = key_of(job.plan.name, node.name, output)
        urgent = any(e.command for e in edges)
        patient = any(e.transport == "bytes" and e.keep == "every" for e in edges)
        stem = f"{job.prefix}{node.name}.{output}"
        near = [(e.index, self._address(e.target)) for e in edges if e.transport == "pool"]
        links = Links(near)
        self._links.append(links)
        return OutPort(
            message,
            links,
            self._session.sender(key, urgent=urgent),
            self._session.sender(key + BYTES_SUFFIX, urgent=urgent, patient=patient),
            readers,
            lambda claim: PoolWriter(self._memory, stem, slots(edges), claim),
            job.epochs[node.name],
        )

    def _listen(self, host: Host, edge: Edge, declared: Input, doors: Doors) -> None:
        job = self._job
        port = InPort(
            declared.message,
            self._ledger.edges[edge.index],
            PoolReader(self._memory, f"{job.prefix}{edge.source}.{edge.output}"),
            job.epochs[edge.target],
            partial(host.deliver, edge.input),
            tap=edge.tap,
        )
        if edge.transport == "pool":
            doors.expect(edge.index, port.receive)
            return
        key = key_of(job.plan.name, edge.source, edge.output) + BYTES_SUFFIX
        self._stops.append(self._session.listen(key, port.receive))

    def _address(self, node: str) -> Path:
        return Path(self._job.run_folder) / f"{node}.door"


def key_of(graph: str, node: str, output: str) -> str:
    """The Zenoh key of an output."""
    return f"fovea/{graph}/{node}/{output}"
