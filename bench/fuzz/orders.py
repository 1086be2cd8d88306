"""Malformed orders to a running graph: each gets one reply, and the graph keeps running.

Orders to the supervisor go to the control server of a small running graph. Orders to a node go to
an operator in this process, in the same way as in a node's process.
"""

import os
import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from bench.fuzz import nasty
from bench.fuzz.tally import Tally, Watch, alone
from pipeline import Frame, Input, Operator, SettingsError
from pipeline.commands import carry_out
from pipeline.errors import GraphError, RunError
from pipeline.graph.loader import load
from pipeline.graph.plan import Plan
from pipeline.node.answers import Q, respond
from pipeline.node.live import Live
from pipeline.protocol.codec import FAILED, MARKER, TAG, VERSION, ControlMessage, Kind, decode
from pipeline.protocol.orders import RESULT, Refused
from pipeline.protocol.questions import Command, ConfigQuestion, NodeSettings, Outcome
from pipeline.run.memory_folder import MEMORY
from pipeline.run.rundir import base
from pipeline.run.supervisor import Supervisor

GRAPH = """\
name: fuzz-orders
nodes:
  metronome: {operator: bench.samples:Metronome, settings: {rate_hz: 100, side_px: 16}}
  forward: {operator: bench.samples:Forward, inputs: {frame: metronome}}
  sink: {operator: bench.samples:Sink, inputs: {frame: forward}}
  spare: {operator: bench.samples:Sink, inputs: {frame: metronome}}
"""
ROUND = 1000  # orders to one run of the graph
ANSWER_S = 120.0
ANSWER = Kind[NodeSettings | Outcome | Refused]("an answer", NodeSettings | Outcome | Refused)
SWAP = {TAG: "SwapOrder", "node": "forward", "operator": "", "changes": {}, "defaults": False,
        "at": 0, "shadow": 0, "probation": 1, "budget_ms": 1000.0}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TunableSettings:
    """One number."""

    gain: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.gain <= 10:
            raise SettingsError(f"gain: expected 0 to 10, got {self.gain}")


class Tunable(Operator[TunableSettings, None]):
    """An operator with live settings and commands."""

    live = ("gain",)
    commands = ("recall",)
    frame = Input(Frame)

    def on_frame(self, frame: Frame) -> None:
        """Ignore the frame."""

    def do_recall(self, last: int = 1, words: tuple[str, ...] = ()) -> dict[str, Any]:
        """Return `last` and the number of words."""
        return {"last": last, "words": len(words)}


def fuzz_orders(count: int, folder: Path, *, seed: int = 0) -> Tally:
    """Send `count` malformed orders, half of them to the supervisor and half to a node."""
    rng, tally = random.Random(seed), Tally()
    watch = Watch(folder, base(), begins=f"{MEMORY}/fovea-{os.geteuid()}-")
    path, home = folder.resolve() / "graph.yaml", folder.resolve() / "home"
    path.write_text(GRAPH)
    home.mkdir()
    to_graph = count // 2
    with alone(home) as made:
        watch.on = True
        _to_node(count - to_graph, rng, tally)
        while to_graph > 0:
            _to_graph(load(path), min(to_graph, ROUND), rng, tally)
            to_graph -= ROUND
        watch.on = False
    return tally.with_touched(watch.touched | made)


def _to_node(count: int, rng: random.Random, tally: Tally) -> None:
    operator = Tunable(TunableSettings())
    live = Live("work", operator, {}, None)
    change = {TAG: "ConfigQuestion", "changes": {"gain": 2.0}}
    order = {TAG: "Command", "command": "recall", "arguments": {"last": 2, "words": ["a"]}}

    def command(told: Command) -> Outcome:
        return Outcome(answer=carry_out("work", operator, told.command, told.arguments))

    for number in range(count):
        if number % 2:
            data = _packed(change, rng)
            tally.check(data, partial(_answered, ConfigQuestion, live.configure, data))
        else:
            data = _packed(order, rng)
            tally.check(data, partial(_answered, Command, command, data))


def _answered(kind: type[Q], act: Callable[[Q], ControlMessage], data: bytes) -> None:
    replies: list[bytes] = []
    respond("work", kind, data, act, replies.append)
    if len(replies) != 1:
        raise AssertionError(f"answered {len(replies)} times")
    answer = decode(ANSWER, replies[0])
    if isinstance(answer, Refused):
        raise RunError(answer.reason)


def _to_graph(plan: Plan, count: int, rng: random.Random, tally: Tally) -> None:
    with Supervisor(plan) as supervisor:
        supervisor.allow_restarts(count)
        supervisor.start()
        for _ in range(count):
            order = _order(supervisor, plan, rng)
            tally.check(order, partial(_asked, supervisor, order))
        tally.check("the graph keeps running", partial(_goes_on, supervisor))


def _order(supervisor: Supervisor, plan: Plan, rng: random.Random) -> bytes:
    running = msgspec.to_builtins(supervisor.plan)
    wanted = msgspec.to_builtins(plan)  # restores what was removed
    document: Mapping[str, Any] = SWAP
    if rng.random() < 0.6:
        what = running if rng.random() < 0.8 else wanted
        document = {TAG: "PlanOrder", "plan": what, "revision": supervisor.manager.revision}
    kind = rng.random()
    if kind < 0.01:
        return _framed(document)
    return _packed(document, rng, 4) if kind < 0.95 else rng.randbytes(rng.randrange(100))


def _asked(supervisor: Supervisor, order: bytes) -> None:
    replies: list[bytes] = []
    supervisor.control.ask(order, replies.append)
    late_s = time.monotonic() + ANSWER_S
    supervisor.control.tick()
    while not replies:
        supervisor.tick()
        if time.monotonic() > late_s:
            raise AssertionError("no answer")
    if len(replies) != 1:
        raise AssertionError(f"answered {len(replies)} times")
    if supervisor.failure:
        raise AssertionError(f"the run failed: {supervisor.failure}")
    result = decode(RESULT, replies[0])
    if isinstance(result, Refused) and result.reason.startswith(FAILED):
        raise AssertionError(result.reason)
    if isinstance(result, Refused):
        raise GraphError(result.reason)


def _goes_on(supervisor: Supervisor) -> None:
    node = supervisor.plan.node("metronome")
    before = supervisor.ledger.nodes[node.index].last_seq
    late_s = time.monotonic() + 8
    while supervisor.ledger.nodes[node.index].last_seq <= before + 5:
        supervisor.tick()
        if time.monotonic() > late_s or supervisor.failure:
            raise AssertionError(f"the source makes no progress {supervisor.failure}")


def _packed(document: Mapping[str, Any], rng: random.Random, most: int = 2) -> bytes:
    """Return a document as a message, mostly malformed: some of its values, or its bytes."""
    kind = rng.random()
    if kind < 0.1:
        return _framed(document)
    if kind < 0.7:
        spoilt = nasty.spoilt(document, rng, rng.choice((1, 1, 2, most)))
        try:
            return _framed(spoilt)
        except (OverflowError, TypeError, ValueError, RecursionError):
            pass  # cannot be encoded: change bytes instead
    if kind < 0.95:
        return nasty.flipped(_framed(document), rng)
    return rng.randbytes(rng.randrange(60))


def _framed(document: Any) -> bytes:
    return bytes((MARKER, VERSION)) + msgspec.msgpack.encode(document)
