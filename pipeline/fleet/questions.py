"""Questions to an agent: bounded queues, and exactly one reply to each, also on errors.

Questions about graphs wait in one queue, requests to start and end them in another, each with its
own thread. A ping for the clock offset is answered at once, on the transport's thread.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from pipeline.bus.session import OnBytes
from pipeline.errors import FoveaError, MessageError
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import MOST_BYTES, ControlMessage, decode, encode, refused
from pipeline.text import error_text

WAITING = 64  # questions in a queue; more are refused at once
TICK_S = 0.1
WARN_S = 1.0
SLOW = ("prepare", "start", "down", "weights", "replan")  # verbs that load, start or stop
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Question:
    """A question and its reply function."""

    verb: str
    asker: str  # identity of the client
    data: bytes
    reply: OnBytes
    sends: bool = False  # weights: it holds the semaphore for them


Answer = Callable[[Question], ControlMessage | None]  # None: another thread replies


class Questions:
    """The waiting questions; thread-safe."""

    def __init__(self) -> None:
        self._looks: queue.Queue[Question] = queue.Queue(WAITING)
        self._works: queue.Queue[Question] = queue.Queue(WAITING)
        self._sending = threading.BoundedSemaphore(1)  # weights are large: one file at a time
        self._quiet_until_s = 0.0

    def put(self, asker: str, key: str, data: bytes, reply: OnBytes) -> None:
        """Queue a question, or reply at once; the last part of its key is the verb."""
        verb = key.rpartition("/")[2]
        if verb == "ping" and len(data) < 64:
            _reply_time(data, reply)
            return
        weights = verb == "weights" and not asker.startswith("host.")
        if len(data) > MOST_BYTES and not weights:
            reply(encode(refused(f"expected up to {MOST_BYTES} bytes, got {len(data)}")))
            return
        if weights and not self._sending.acquire(blocking=False):
            reply(encode(refused("busy: it is receiving weights from another client")))
            return
        try:
            waiting = self._works if verb in SLOW else self._looks
            waiting.put_nowait(Question(verb, asker, data, reply, sends=weights))
        except queue.Full:
            if weights:
                self._sending.release()
            reply(encode(refused("busy: too many questions are pending")))

    def answer_next(self, answer: Answer, *, slow: bool) -> bool:
        """Answer one slow or fast question; return False when none came for a moment."""
        waiting = self._works if slow else self._looks
        try:
            question = waiting.get(timeout=TICK_S)
        except queue.Empty:
            return False
        try:
            said = self._said(question, answer)
        finally:
            if question.sends:  # before the reply: the client may send the next file at once
                self._sending.release()
        if said is not None:
            question.reply(said)
        return True

    def _said(self, question: Question, answer: Answer) -> bytes | None:
        """Return the reply to a question; None if another thread will send it."""
        try:
            message = answer(question)
            return None if message is None else encode(message)
        except FoveaError as error:
            self.warn_once(f"refused {question.verb} to {question.asker}: {error}")
            return encode(refused(str(error)))
        except Exception as error:  # a bug in the agent: keep answering other questions
            log.exception("%s of %s failed", question.verb, question.asker)
            return encode(refused(f"{question.verb} failed: {error_text(error)}"))

    def warn_once(self, why: str) -> None:
        """Log a warning, at most once a second."""
        if time.monotonic() > self._quiet_until_s:
            self._quiet_until_s = time.monotonic() + WARN_S
            log.warning("%s", why)


def _reply_time(data: bytes, reply: OnBytes) -> None:
    came_ns = time.monotonic_ns()
    try:
        sent_ns = decode(wire.Ping, data).sent_ns
    except MessageError:
        return
    reply(encode(wire.Pong(sent_ns, came_ns, time.monotonic_ns())))
