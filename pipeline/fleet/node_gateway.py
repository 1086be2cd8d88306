"""Requests from elsewhere to the nodes on this host: settings, commands, swaps.

The same rules hold as for a graph that is brought up: code by the allow list, files by checksum.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from threading import BoundedSemaphore
from typing import Any

import msgspec

from pipeline.errors import FoveaError, RunError
from pipeline.fleet.allow import Allowed
from pipeline.fleet.hosted_graph import HostedGraph
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import encode, refused
from pipeline.protocol.orders import SwapOrder
from pipeline.protocol.questions import Command, ConfigQuestion, NodeQuestion
from pipeline.run.bus_client import ask_local
from pipeline.settings import suggest

AT_ONCE = 4  # a node answers between two frames; one that hangs must not hold up the others
WAITING = 16
Reply = Callable[[bytes], None]


class NodeGateway:
    """Forwards requests to the nodes of a host."""

    def __init__(self, allowed: Allowed, over: Mapping[str, Mapping[str, Any]]) -> None:
        """`over`: what this host sets itself, by node; nobody else may change it."""
        self._allowed, self._over = allowed, over
        self._pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="gateway")
        self._room = BoundedSemaphore(AT_ONCE + WAITING)

    def close(self) -> None:
        """Answer no more."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def ask(self, hosted: HostedGraph, asked: wire.ToNode, reply: Reply) -> None:
        """Put a question to a node and reply when it answers; raises `FoveaError`."""
        _here(hosted, asked.node)
        question = self._cleared(asked)
        if not self._room.acquire(blocking=False):
            raise RunError("busy: too many questions wait for nodes")
        self._pool.submit(self._ask, hosted, asked.node, question, reply)

    def swap(self, hosted: HostedGraph, order: SwapOrder, reply: Reply) -> None:
        """Have a node swapped and reply when that is done; raises `FoveaError`."""
        _here(hosted, order.node)
        supervisor = hosted.supervisor
        if supervisor is None:
            raise RunError(f"{hosted.plan.name}: does not run just now, try again")
        if order.operator:
            self._allowed.check_code(order.operator, f"{order.node}.operator")
        changes = {**self._cleared_values(order.node, order.changes), **self._own(order.node)}
        order = msgspec.structs.replace(order, changes=changes)

        def done(result: bytes) -> None:
            reply(encode(wire.Relayed(result)))

        supervisor.control.ask(encode(order), done)

    def _ask(self, hosted: HostedGraph, node: str, question: NodeQuestion, reply: Reply) -> None:
        try:
            said = ask_local(hosted.folder, hosted.plan.name, node, question)
            reply(encode(wire.Relayed(said)))
        except FoveaError as error:
            reply(encode(refused(str(error))))
        finally:
            self._room.release()

    def _cleared(self, asked: wire.ToNode) -> NodeQuestion:
        """The question without anything that must not come from outside; raises `FoveaError`."""
        question = asked.question
        if isinstance(question, ConfigQuestion):
            return ConfigQuestion(self._cleared_values(asked.node, question.changes))
        if isinstance(question, Command):
            where = f"{asked.node} {question.command}"
            return Command(question.command, self._allowed.localise(question.arguments, where))
        return question

    def _cleared_values(self, node: str, changes: Mapping[str, Any]) -> dict[str, Any]:
        for name in changes:
            if name in self._own(node):
                raise RunError(f"{node}.{name}: this host sets it itself")
        return {k: self._allowed.localise(v, f"{node}.{k}") for k, v in changes.items()}

    def _own(self, node: str) -> Mapping[str, Any]:
        return self._over.get(node, {})


def _here(hosted: HostedGraph, node: str) -> None:
    names = [n.name for n in hosted.plan.nodes if hosted.plan.is_here(n)]
    if node not in names:
        raise RunError(f"{hosted.plan.name}: no node {node} here{suggest(node, names)}")
