"""Spans of exposures, from taps on the outputs of a running graph.

A trace begins when the sensor exposes and ends with the last output that the exposure led to. The
span of an output lasts from the arrival of the last input that it can have used until its own: the
time in the queue, in the handler and on the bus, as a listener sees it. Commands overtake other
messages, and outputs of nodes in one process arrive almost together, so that an input may be heard
after what came of it; then the last output before counts. A graph that nobody traces pays nothing.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import NamedTuple

from pipeline.bus.tap import Missed
from pipeline.client.graph_client import GraphClient, Listener
from pipeline.errors import RunError

WAIT_S = 1.0  # for the outputs of an exposure; what comes later is not in its trace
MOST_OPEN = 1024  # exposures in hand; above it the oldest ends early
LOOK_S = 0.1
Inputs = Mapping[str, Sequence[str]]  # output -> outputs that its node reads


class Arrival(NamedTuple):
    """What a listener heard of an output for one exposure."""

    at_ns: int  # monotonic time
    nothing: bool  # the node said that it has no message for this exposure
    after_loss: bool  # messages of this output were missed just before it


@dataclass
class Exposure:
    """What was heard of one exposure so far."""

    stream: str
    seq: int
    exposed_ns: int | None  # monotonic time here; None while the clock of its host is not known
    began_ns: int  # first arrival
    outputs: dict[str, Arrival] = field(default_factory=dict)


class Span(NamedTuple):
    """A part of the way of an exposure; times are monotonic."""

    name: str
    begin_ns: int
    end_ns: int
    attributes: Mapping[str, str | int | bool]


class Exposures:
    """Arrivals by exposure. Any thread may call it."""

    def __init__(self, outputs: Sequence[str], wait_s: float = WAIT_S, since_ns: int = 0) -> None:
        """`since_ns`: what was exposed before that time is left out, as it was not heard whole."""
        self._outputs, self._wait_ns = frozenset(outputs), int(wait_s * 1e9)
        self._since_ns = since_ns
        self._open: dict[tuple[str, int], Exposure] = {}
        self._lock = threading.Lock()
        self.late = 0  # arrivals after their exposure had ended
        self._ended: dict[str, int] = {}  # stream -> newest exposure that has ended

    def add(
        self, output: str, stream: str, seq: int, arrival: Arrival, exposed_ns: int | None
    ) -> None:
        """Add an arrival; count one whose exposure has ended."""
        if (arrival.at_ns if exposed_ns is None else exposed_ns) < self._since_ns:
            return
        with self._lock:
            found = self._open.get((stream, seq))
            if found is None:
                if seq <= self._ended.get(stream, -1):
                    self.late += 1
                    return
                found = Exposure(stream, seq, exposed_ns, arrival.at_ns)
                self._open[stream, seq] = found
            found.outputs.setdefault(output, arrival)
            if found.exposed_ns is None:
                found.exposed_ns = exposed_ns

    def ended(self, now_ns: int, *, all_of_them: bool = False) -> list[Exposure]:
        """Return and forget the exposures that are complete or waited long enough."""
        with self._lock:
            spare = len(self._open) - MOST_OPEN
            done = [
                key for number, (key, one) in enumerate(self._open.items())
                if all_of_them or number < spare or self._outputs <= one.outputs.keys()
                or now_ns - one.began_ns > self._wait_ns
            ]  # fmt: skip
            for stream, seq in done:
                self._ended[stream] = max(seq, self._ended.pop(stream, -1))
            while len(self._ended) > MOST_OPEN:  # a source that began anew has another stream
                del self._ended[next(iter(self._ended))]
            return [self._open.pop(key) for key in done]


def spans_of(exposure: Exposure, inputs: Inputs) -> Iterator[Span]:
    """Yield the span of the exposure, then one for each output, in order of arrival.

    >>> heard = {"eye.out": Arrival(30, False, False), "see.out": Arrival(70, False, False)}
    >>> one = Exposure("a", 5, 10, 30, heard)
    >>> [(s.name, s.begin_ns, s.end_ns) for s in spans_of(one, {"see.out": ["eye.out"]})]
    [('exposure', 10, 70), ('eye.out', 10, 30), ('see.out', 30, 70)]
    """
    outputs = sorted(exposure.outputs.items(), key=lambda item: item[1].at_ns)
    last_ns = outputs[-1][1].at_ns
    first_ns = min(exposure.began_ns, outputs[0][1].at_ns)
    begin_ns = first_ns if exposure.exposed_ns is None else min(exposure.exposed_ns, first_ns)
    what: dict[str, str | int | bool] = {
        "fovea.stream": exposure.stream, "fovea.seq": exposure.seq
    }  # fmt: skip
    known = {"fovea.exposure_known": exposure.exposed_ns is not None}
    yield Span("exposure", begin_ns, last_ns, {**what, **known})
    for name, arrival in outputs:
        marks = {"fovea.nothing": arrival.nothing, "fovea.after_loss": arrival.after_loss}
        attributes = {**what, **{mark: True for mark, found in marks.items() if found}}
        from_ns = _last_before(name, exposure.outputs, inputs)
        yield Span(name, begin_ns if from_ns is None else from_ns, arrival.at_ns, attributes)


def _last_before(name: str, outputs: Mapping[str, Arrival], inputs: Inputs) -> int | None:
    """Return when the last input of an output was heard before it; if none, one further back."""
    seen, wave = {name}, list(inputs.get(name, ()))
    while wave:
        heard = [outputs[one].at_ns for one in wave if one in outputs]
        if before := [at_ns for at_ns in heard if at_ns <= outputs[name].at_ns]:
            return max(before)
        seen.update(wave)
        wave = [further for one in wave for further in inputs.get(one, ()) if further not in seen]
    return None


def inputs_of(client: GraphClient) -> dict[str, list[str]]:
    """Return every output that somebody reads, and the outputs that its node reads.

    Raises `RunError` for a graph without an edge.
    """
    hosts = client.status().hosts.values()
    edges = [edge for said in hosts if not isinstance(said, str) for s in said for edge in s.edges]
    if not edges:
        raise RunError(f"{client.name}: expected edges to trace, got none")
    read: dict[str, list[str]] = {}
    for edge in edges:
        read.setdefault(edge.end.partition(".")[0], []).append(edge.origin)
    return {edge.origin: read.get(edge.origin.partition(".")[0], []) for edge in edges}


class Tracing:
    """Listens to outputs of a running graph and passes on its exposures; use it as a context."""

    def __init__(
        self, client: GraphClient, inputs: Inputs, emit: Callable[[Sequence[Span]], None]
    ) -> None:
        """`emit` gets the spans of one exposure, in the thread that calls `run`."""
        self._inputs, self._emit = inputs, emit
        self._listeners = [client.listen(output) for output in inputs]
        self._exposures = Exposures(())
        self._open, self._stop = ExitStack(), threading.Event()
        self.exposures = 0

    def __enter__(self) -> "Tracing":
        with ExitStack() as opening:  # closes what is open already, if the next cannot be opened
            for listener in self._listeners:
                opening.enter_context(listener)
            self._exposures = Exposures(list(self._inputs), since_ns=time.monotonic_ns())
            for listener in self._listeners:
                thread = threading.Thread(
                    target=self._listen, args=(listener,), name=f"trace-{listener.output}"
                )
                thread.start()
                opening.callback(thread.join)
                opening.callback(self._stop.set)
            self._open = opening.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()
        self._pass_on(all_of_them=True)

    @property
    def missed(self) -> Missed:
        """The messages that its taps did not get."""
        found = [listener.tap.missed for listener in self._listeners]
        return Missed(*(sum(parts) for parts in zip(*found, strict=True)))

    @property
    def late(self) -> int:
        """The messages that came after the trace of their exposure had ended."""
        return self._exposures.late

    def run(self, still: Callable[[], bool]) -> str:
        """Pass exposures on while `still` returns True; return why the graph ended, if it did."""
        while still():
            self._stop.wait(LOOK_S)
            self._pass_on()
            if over := next(filter(None, (listener.over() for listener in self._listeners)), ""):
                return over
        return ""

    def _pass_on(self, *, all_of_them: bool = False) -> None:
        for exposure in self._exposures.ended(time.monotonic_ns(), all_of_them=all_of_them):
            self._emit(list(spans_of(exposure, self._inputs)))
            self.exposures += 1

    def _listen(self, listener: Listener) -> None:
        while not self._stop.is_set():
            heard = listener.tap.next(LOOK_S)
            if heard is None:
                continue
            age_ns = listener.age_ns(heard)
            exposed_ns = None if age_ns is None else heard.at_ns - age_ns
            arrival = Arrival(heard.at_ns, heard.message is None, heard.after_loss)
            header = heard.header
            self._exposures.add(listener.output, header.stream, header.seq, arrival, exposed_ns)
