"""The four questions that every node answers, below its own key.

@schema    what it takes and gives, how it can be set and told
@health    how it is; answered by the transport's thread, so also by a node that hangs
@config    its settings, and a change of live ones
@command   something to be done
"""

from collections.abc import Callable
from typing import Any

import msgspec

from pipeline.bus.ledger import Ledger
from pipeline.bus.session import OnBytes, OnQuestion, Session
from pipeline.commands import COMMAND, Outcome, obey, write_outcome
from pipeline.contract import Operator
from pipeline.graph.plan import Node, Plan
from pipeline.node.health import HEALTH, examine, write_health
from pipeline.node.interface import SCHEMA, interface, write_interface
from pipeline.node.live import CONFIG, Live
from pipeline.node.operator_runner import OperatorRunner
from pipeline.text import error_text, harmless

MOST_WORDS = 2000  # characters of a headline


class Answers:
    """What one node answers while its runner runs."""

    def __init__(
        self, plan: Plan, node: Node, operator: Operator[Any, Any], runner: OperatorRunner,
        live: Live, ledger: Ledger,
    ) -> None:  # fmt: skip
        self.plan, self._node, self._operator = plan, node, operator
        self._runner, self._live, self._ledger = runner, live, ledger

    def serve(self, session: Session, key: Callable[[str], str]) -> list[Callable[[], None]]:
        """Begin to answer under the node's own keys; returns how to stop."""
        answers: dict[str, OnQuestion] = {
            SCHEMA: self._on_schema,
            HEALTH: self._on_health,
            CONFIG: self._on_config,
            COMMAND: self._on_command,
        }
        return [session.answer(key(name), act) for name, act in answers.items()]

    def _on_schema(self, _question: bytes, reply: OnBytes) -> None:
        reply(write_interface(interface(self._node.name, type(self._operator))))

    def _on_health(self, _question: bytes, reply: OnBytes) -> None:
        try:
            words = harmless(str(self._operator.headline()), MOST_WORDS)
        except Exception as error:  # the thread that asks every second makes an end of it
            words = harmless(error_text(error))
        reply(write_health(examine(self.plan, self._node, self._ledger, words)))

    def _on_config(self, question: bytes, reply: OnBytes) -> None:
        if not self._runner.between(lambda: self._live.answer(question, reply)):
            reply(msgspec.msgpack.encode(self._live.describe(self._overrun())))

    def _on_command(self, question: bytes, reply: OnBytes) -> None:
        name, operator = self._node.name, self._operator
        if not self._runner.between(lambda: obey(name, operator, question, reply)):
            reply(write_outcome(Outcome(refused=self._overrun())))

    def _overrun(self) -> str:
        return f"{self._node.name}: too many questions wait already"
