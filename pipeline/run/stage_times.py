"""Measure what nodes take: a plan in, processor and wall time of their calls out.

The graph runs in line once, and what the nodes in question were given is kept. Each of them is then
called with that again, alone in this process, as often as there are ways to run it.
"""

import statistics
import time
from collections.abc import Callable, Collection, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np

from pipeline import settings as checked
from pipeline.contract import settings_of
from pipeline.executor import Answers, Executor, open_operator
from pipeline.graph.plan import Node, Plan, load_operator
from pipeline.messages import Message
from pipeline.run.inline import InlineRunner

WARM_UP = 3  # frames that do not count: networks allocate, caches fill
MOST_BYTES = 1 << 30  # of messages that are kept
Call = Mapping[str, Message | None]


@dataclass(frozen=True, kw_only=True)
class StageTime:
    """A node's share of a frame, milliseconds."""

    wall_ms: float  # p90 over frames
    cpu_ms: float  # of all threads, mean


@dataclass(kw_only=True)
class Recorded:
    """What nodes were given, frame by frame."""

    calls: dict[str, list[list[Call]]] = field(default_factory=dict)  # by node, by frame
    cpu_ms: float = 0.0  # of a frame, of all nodes together with what draws or reads it
    frames: int = 0


class _Listening(Executor):
    """Keeps what its operator is given."""

    given: list[Call]

    def call(self, messages: Call) -> Answers:
        """As `Executor.call`."""
        self.given.append(deepcopy(dict(messages)))  # a source may use its memory again
        return super().call(messages)


def tunable(plan: Plan) -> dict[str, Any]:
    """Return the built settings of the nodes that have a setting `threads`."""
    found = {}
    for node in plan.nodes:
        cls = settings_of(load_operator(node.operator))
        if is_dataclass(cls) and "threads" in {each.name for each in fields(cls)}:
            found[node.name] = checked.build(cls, node.settings, node.name)
    return found


def record(
    plan: Plan, nodes: Collection[str], frames: int, limit_s: float,
    step: Callable[[], None] = lambda: None,
) -> Recorded:  # fmt: skip
    """Run the graph in line; keep what `nodes` are given until a limit of frames, time, memory."""
    listening = {name: _Listening(name, built(plan.node(name), {})) for name in nodes}
    for executor in listening.values():
        executor.given = []
    found, kept_bytes = Recorded(calls={name: [] for name in nodes}), 0
    with InlineRunner(plan, played=listening) as runner:
        late_s, began_ns = time.monotonic() + limit_s, time.process_time_ns()
        for number, _ in enumerate(runner.run(WARM_UP + frames)):
            for name, executor in listening.items():
                found.calls[name].append(executor.given)
                kept_bytes += sum(_size(m) for call in executor.given for m in call.values())
                executor.given = []
            if number + 1 == WARM_UP:
                began_ns = time.process_time_ns()
            found.frames = number + 1
            step()
            if number > WARM_UP and (time.monotonic() > late_s or kept_bytes > MOST_BYTES):
                break
        spent_ms = (time.process_time_ns() - began_ns) / 1e6
    found.cpu_ms = spent_ms / max(1, found.frames - WARM_UP)
    return found


def built(node: Node, changes: Mapping[str, Any]) -> Any:
    """Return a node's operator with some settings changed."""
    cls = load_operator(node.operator)
    return cls(checked.build(settings_of(cls), {**node.settings, **changes}, node.name))


def replayed(node: Node, changes: Mapping[str, Any], frames: list[list[Call]]) -> StageTime:
    """Call a node's operator, with some settings changed, with what it was given once."""
    operator = built(node, changes)
    executor = Executor(node.name, operator)
    spent: list[tuple[int, int]] = []
    stream = None
    open_operator(node.name, operator)
    try:
        for calls in frames:
            began = time.perf_counter_ns(), time.process_time_ns()
            for call in calls:
                first = next((message for message in call.values() if message is not None), None)
                if first is not None and first.header.stream != stream:
                    stream = first.header.stream
                    operator.on_stream(first.header)
                executor.call(call)
            spent.append((time.perf_counter_ns() - began[0], time.process_time_ns() - began[1]))
    finally:
        operator.close()
    return told(spent[min(WARM_UP, len(spent) - 1) :])


def told(spent: list[tuple[int, int]]) -> StageTime:
    """Return the figures of (wall, processor) nanoseconds by frame.

    >>> told([(1_000_000, 2_000_000), (3_000_000, 4_000_000)])
    StageTime(wall_ms=2.8, cpu_ms=3.0)
    """
    walls, cpus = ([each[side] / 1e6 for each in spent] for side in (0, 1))
    late = statistics.quantiles(walls, n=10, method="inclusive")[-1] if len(walls) > 1 else walls[0]
    return StageTime(wall_ms=round(late, 3), cpu_ms=round(statistics.fmean(cpus), 3))


def _size(message: Message | None) -> int:
    if message is None:
        return 0
    parts = (getattr(message, each.name) for each in fields(message))
    return sum(part.nbytes for part in parts if isinstance(part, np.ndarray))
