"""`fovea echo | hz`: what an output of a running graph sends, as a tap on it hears it.

A tap reads the graph's bus beside the readers of the output, so the output needs none; it cannot
slow the graph down. It says how many messages it missed, and why: its figures are the output's.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import numpy as np

from pipeline.bus.tap import Heard, Missed, Tap
from pipeline.console.watching import find
from pipeline.contract import outputs_of
from pipeline.errors import RunError
from pipeline.graph.plan import load_operator
from pipeline.messages import Message
from pipeline.node.wiring import key_of
from pipeline.run.bus_client import client_session
from pipeline.run.rundir import running
from pipeline.settings import suggest

QUIET_S = 10.0  # without a message for this long, echo says so and leaves
LOOK_S = 0.5  # without one for this long, it looks whether the graph still runs
SILENT_S = 0.5  # and hz says that the output has fallen silent, if that is long for it
SILENT_GAPS = 3


class Listener:
    """A tap on one output of a graph that runs on this host."""

    def __init__(self, graph: str, output: str) -> None:
        """Raises `RunError` for no such graph, node or output."""
        self.graph, self.facts = find(graph)
        self.output = output
        node, _, port = output.partition(".")
        operators = {n["name"]: n["operator"] for n in self.facts["nodes"]}
        if node not in operators:
            raise RunError(f"{self.graph}: no node {node}{suggest(node, operators)}")
        outputs = outputs_of(load_operator(operators[node]))
        self.node, self.port = node, port or "out"
        if self.port not in outputs:
            options = [o if o != "out" else node for o in (f"{node}.{p}" for p in outputs)]
            hint = suggest(output, options)
            raise RunError(f"{self.graph}: {node} has no output {self.port}{hint}")
        self.tap = Tap(outputs[self.port])

    @contextmanager
    def attached(self) -> Iterator[Tap]:
        """Hear the output meanwhile."""
        with client_session(self.graph, "tap") as session:
            key = key_of(self.facts["graph"], self.node, self.port)
            stop = session.listen(key, self.tap.receive)
            try:
                yield self.tap
            finally:
                stop()

    def over(self) -> str:
        """Why nothing more will come, in a sentence; empty while something may."""
        now = running().get(self.graph, {})
        if now.get("run") != self.facts["run"]:
            return f"{self.graph}: the graph has ended"
        if self.node not in [n["name"] for n in now["nodes"]]:
            return f"{self.graph}: {self.node} was removed"
        return ""


def echo(graph: str, output: str, count: int) -> Iterator[str]:
    """One line per message of an output, and one wherever some were missed.

    Ends with the graph; raises `RunError` when that is before `count`, or nothing comes for long.
    """
    listener, told, heard_s, nothings = Listener(graph, output), Missed(), time.monotonic(), 0
    messages = 0
    with listener.attached() as tap:
        while not count or messages < count:
            heard, missed = tap.next(LOOK_S), tap.missed
            if missed != told:
                yield str(missed.since(told))
                told = missed
            if heard is not None and heard.message is not None:
                messages, heard_s, nothings = messages + 1, time.monotonic(), 0
                yield describe(heard.message)
                continue
            nothings += heard is not None
            if time.monotonic() - heard_s > QUIET_S:
                raise RunError(f"{output}: no message for {QUIET_S:.0f} s{_times(nothings)}")
            if heard is None and (over := listener.over()):
                if count:
                    raise RunError(f"{over} after {messages} of {count} messages of {output}")
                yield over
                return


def rate(graph: str, output: str, duration_s: float) -> str:
    """Rate, jitter and age over some seconds; raises `RunError` when no message comes."""
    listener = Listener(graph, output)
    heard: list[Heard] = []
    end_s, over = time.monotonic() + duration_s, ""
    with listener.attached() as tap:
        while not over and (left_s := end_s - time.monotonic()) > 0:
            one = tap.next(min(left_s, LOOK_S))
            if one is not None:
                heard.append(one)
            else:
                over = listener.over()
        text = figures(output, heard, tap.missed, time.monotonic_ns(), duration_s)
        instances = tap.instances
    again = f"; {instances - 1} times another instance took over" if instances > 1 else ""
    return f"{text}{again}" + (f"; {over}" if over else "")


def figures(output: str, heard: list[Heard], missed: Missed, now_ns: int, duration_s: float) -> str:
    """What was heard until now, in a line; raises `RunError` for no message at all."""
    messages = [one for one in heard if one.message is not None]
    nothings = len(heard) - len(messages)
    extra = _times(nothings) + (f"; {missed}" if sum(missed) else "")
    if not messages:
        raise RunError(f"{output}: no message in {duration_s:.1f} s{extra}")
    if len(messages) < 2:
        return f"{output}: fewer than two messages in {duration_s:.1f} s{extra}"
    stamps = np.array([one.at_ns for one in messages], np.int64)
    gaps = np.diff(stamps) / 1e6
    whole = gaps[[not one.after_loss for one in messages[1:]]]
    ages = [(one.at_ns - one.header.stamp_ns) / 1e6 for one in messages]
    silent_s = (now_ns - stamps[-1]) / 1e9
    span_s, sent = (stamps[-1] - stamps[0]) / 1e9, len(messages) + sum(missed) - 1
    if silent_s > max(SILENT_S, SILENT_GAPS * gaps.max() / 1e3):
        span_s, sent = span_s + silent_s, sent + 1
        extra = f", none in the last {silent_s:.1f} s{extra}"
    jitter = (
        f"gap {whole.min():.1f} .. {whole.max():.1f} ms (std {whole.std():.2f})"
        if len(whole)
        else "no two messages in a row"
    )
    return (
        f"{output}: {sent / span_s:.2f} Hz, {jitter}, age {np.median(ages):.1f} ms p50, "
        f"{len(messages)} messages{extra}"
    )


def describe(message: Message) -> str:
    """A message on one line: small values as they are, arrays by shape."""
    parts = [f"seq {message.header.seq}"]
    for item in fields(message):
        value: Any = getattr(message, item.name)
        if item.name == "header":
            continue
        if isinstance(value, np.ndarray):
            small = np.array2string(value, precision=1, separator=",").replace("\n", "")
            text = small if value.size <= 8 else f"{value.dtype}{list(value.shape)}"
        else:
            text = str(value)
        parts.append(f"{item.name} {text}")
    return "  ".join(parts)


def _times(nothings: int) -> str:
    return f", {nothings} times nothing" if nothings else ""
