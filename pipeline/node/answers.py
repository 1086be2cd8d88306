"""Answers of a node to questions (`pipeline.protocol.questions`).

The transport's thread answers questions on schema and health; the operator's thread handles
settings and commands, between two calls of handlers.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from pipeline.bus.ledger import Ledger
from pipeline.bus.session import OnBytes, OnQuestion, Session
from pipeline.cause import cause_of
from pipeline.commands import carry_out
from pipeline.contract import Operator
from pipeline.errors import FoveaError
from pipeline.graph.plan import Node, Plan
from pipeline.node.health import examine
from pipeline.node.interface import interface
from pipeline.node.live import Live
from pipeline.node.operator_runner import OperatorRunner
from pipeline.protocol.codec import ControlMessage, Kind, decode, encode, refused
from pipeline.protocol.questions import (
    COMMAND,
    CONFIG,
    HEALTH,
    SCHEMA,
    Command,
    ConfigQuestion,
    Health,
    HealthQuestion,
    Interface,
    Outcome,
    SchemaQuestion,
)
from pipeline.text import error_text, harmless

MOST_WORDS = 2000  # characters of a headline
Q = TypeVar("Q", bound=ControlMessage)


class Answers:
    """The answers of one node while its runner runs."""

    def __init__(
        self, plan: Plan, node: Node, operator: Operator[Any, Any], runner: OperatorRunner,
        live: Live, ledger: Ledger,
    ) -> None:  # fmt: skip
        self.plan, self._node, self._operator = plan, node, operator
        self._runner, self._live, self._ledger = runner, live, ledger

    def serve(self, session: Session, key: Callable[[str], str]) -> list[Callable[[], None]]:
        """Start answering on the node's keys; return functions to stop."""
        answers: dict[str, OnQuestion] = {
            SCHEMA: self._at_once(SchemaQuestion, self._schema),
            HEALTH: self._at_once(HealthQuestion, self._health),
            CONFIG: self._between(ConfigQuestion, self._live.configure),
            COMMAND: self._between(Command, self._command),
        }
        return [session.answer(key(name), act) for name, act in answers.items()]

    def _at_once(self, kind: type[Q], act: Callable[[Q], ControlMessage]) -> OnQuestion:
        """Answer on the transport's thread."""
        return lambda question, reply: respond(self._node.name, kind, question, act, reply)

    def _between(self, kind: type[Q], act: Callable[[Q], ControlMessage]) -> OnQuestion:
        """Answer on the handlers' thread, between two calls."""
        name = self._node.name

        def take(question: bytes, reply: OnBytes) -> None:
            if not self._runner.between(lambda: respond(name, kind, question, act, reply)):
                reply(encode(refused(f"{name}: too many questions are pending")))

        return take

    def _schema(self, _question: SchemaQuestion) -> Interface:
        return interface(self._node.name, type(self._operator))

    def _health(self, _question: HealthQuestion) -> Health:
        try:
            words = harmless(str(self._operator.headline()), MOST_WORDS)
        except Exception as error:  # the same error ends the node in its own thread
            words = harmless(error_text(error))
        return examine(self.plan, self._node, self._ledger, words)

    def _command(self, question: Command) -> Outcome:
        name, operator = self._node.name, self._operator
        return Outcome(answer=carry_out(name, operator, question.command, question.arguments))


def respond(
    node: str,
    kind: Kind[Q] | type[Q],
    question: bytes,
    act: Callable[[Q], ControlMessage],
    reply: OnBytes,
) -> None:
    """Reply with the result of `act`, or with a refusal if it raises `FoveaError`.

    Any other exception is reported and raised again: the operator has failed.
    """
    try:
        answer = encode(act(decode(kind, question)))
    except FoveaError as error:
        answer = encode(refused(str(error)))
    except Exception as error:
        reply(encode(refused(f"{node}: it failed and restarts: {cause_of(error)}")))
        raise
    reply(answer)
