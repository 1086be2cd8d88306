"""A recording in place of nodes of a graph, and recomputed outputs compared with recorded ones."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from pipeline.contract import Operator, Source, joined, outputs_of
from pipeline.errors import GraphError
from pipeline.executor import Answers, Executor
from pipeline.graph.plan import Plan, is_source, load_operator, sources
from pipeline.messages import Header, Message
from pipeline.recording.reader import Exposure, Recording
from pipeline.settings import suggest

Place = tuple[int, int]  # of an exposure: the number of its stream, and its own in it


@dataclass(frozen=True, kw_only=True)
class NoSettings:
    """A recording has none of the settings of the node that it replaces."""


class PlayedNode(Operator[NoSettings, None]):
    """Stands for an operator that does not run."""


class PlayedSource(Source[NoSettings, Message]):
    """Stands for a source that does not run."""


class Played(Executor):
    """Answers for a node with what was recorded of it."""

    def __init__(self, plan: Plan, node: str, recording: Recording) -> None:
        cls = load_operator(plan.node(node).operator)
        idle = PlayedSource if issubclass(cls, Source) else PlayedNode
        super().__init__(node, idle(NoSettings()))
        self._types, self._recording = outputs_of(cls), recording
        self._joined = frozenset(joined(cls))
        self._left = iter(exposures(recording, node, self._types))

    def is_side(self, names: tuple[str, ...]) -> bool:
        """Whether these inputs are outside the joined set of the node that it replaces."""
        return not self._joined.issuperset(names)

    def call(self, messages: Mapping[str, Message | None]) -> Answers:
        """Return what the node had answered to this exposure."""
        if self.is_side(tuple(messages)):
            return {}
        header = next(m.header for m in messages.values() if m is not None)
        return self._answers((header.stream, header.seq))

    def produce(self) -> Answers | None:
        """Return the next exposure; None at the end of the recording."""
        exposure = next(self._left, None)
        return None if exposure is None else self._answers(exposure)

    def _answers(self, exposure: Exposure) -> Answers:
        return {
            output: self._recording.message(f"{self._node}.{output}", cls, exposure)
            for output, cls in self._types.items()
        }


def exposures(recording: Recording, node: str, outputs: Iterable[str]) -> list[Exposure]:
    """Return the exposures of which an output of a node was recorded, in order."""
    found: set[Exposure] = set()
    for output in outputs:
        found |= recording.messages.get(f"{node}.{output}", {}).keys()
    return sorted(found, key=in_order(recording))


def in_order(recording: Recording) -> Callable[[Exposure], Place]:
    """Return what finds the place of an exposure in the order of all.

    Streams are in the order of the file; within one, frames are in their own order.
    """
    streams: dict[str, int] = {}
    for stream, _seq in recording.exposures:
        streams.setdefault(stream, len(streams))
    return lambda one: (streams[one[0]], one[1])


def stand_ins(plan: Plan, recording: Recording, nodes: Iterable[str] = ()) -> dict[str, Played]:
    """Return what stands for `nodes`, and for the sources in any case.

    Raises `GraphError` when an output that another node reads was not recorded.
    """
    names = [node.name for node in plan.nodes]
    replaced = {node.name for node in sources(plan)} | set(nodes)
    for name in sorted(replaced):
        if name not in names:
            raise GraphError(f"{plan.name}: no node {name}{suggest(name, names)}")
        for edge in plan.edges:
            output = f"{edge.source}.{edge.output}"
            if edge.source != name or edge.target in replaced or edge.optional:
                continue
            if output not in recording.messages:
                known = ", ".join(sorted(recording.messages)) or "no output"
                raise GraphError(
                    f"{recording.path}: {edge.end} reads {edge.origin}: expected it in the "
                    f"recording, got {known}"
                )
    return {name: Played(plan, name, recording) for name in replaced}


@dataclass(frozen=True)
class Difference:
    """Where a recomputed message differs from the recorded one."""

    output: str
    seq: int
    field: str
    what: str

    def __str__(self) -> str:
        """Return it as a sentence."""
        return f"{self.output}: frame {self.seq}: {self.field}: {self.what}"


class Verifier:
    """Compares what a replay computes with what was recorded; pass `watch` to the runner.

    A recorder that joins or leaves a running graph does so between the outputs of an exposure.
    What is before the first or behind the last exposure of which both an output and the outputs
    that are played were recorded is therefore left out, and counted in `outside`.
    """

    def __init__(self, plan: Plan, recording: Recording, replaced: Collection[str]) -> None:
        self._recording, self._place = recording, in_order(recording)
        self.first: Difference | None = None
        self.compared, self.different = 0, 0
        self.outside = 0  # messages that were recorded or computed
        self.unrecorded: set[str] = set()  # outputs that the replay computed and the file lacks
        self._types = {
            f"{node.name}.{output}": cls
            for node in plan.nodes
            if node.name not in replaced
            for output, cls in outputs_of(load_operator(node.operator)).items()
        }
        self._left = {
            output: set(recording.messages[output])
            for output in self._types
            if output in recording.messages
        }
        whole = recording.newest("report")  # it ends a run that was recorded from its first frame
        played = [] if whole else _spans(plan, recording, replaced)
        self._spans = {} if whole else {
            output: [*played, _span(recording, recording.messages[output])] for output in self._left
        }  # fmt: skip

    def check(self) -> None:
        """Raise `GraphError` when no output that the replay computes was recorded."""
        if not self._left:
            known = ", ".join(sorted(self._recording.messages)) or "no output"
            wanted = ", ".join(sorted(self._types))
            raise GraphError(
                f"{self._recording.path}: cannot be verified: "
                + (f"expected an output that is computed ({wanted}), got {known}" if wanted
                   else "expected a node that computes an output, got the recording for each")
            )  # fmt: skip

    def watch(self, output: str, message: Message) -> None:
        """Compare a message that the replay computed."""
        if output not in self._left:
            if output in self._types:
                self.unrecorded.add(output)
            return
        header = message.header
        exposure = (header.stream, header.seq)
        self._left[output].discard(exposure)
        if not self._is_within(output, exposure):
            self.outside += 1
            return
        self.compared += 1
        recorded = self._recording.message(output, self._types[output], exposure)
        self._judge(output, header, recorded, message)

    def finish(self) -> None:
        """Count what was recorded and, in a whole replay, not computed again."""
        for output, left in self._left.items():
            within = [one for one in left if self._is_within(output, one)]
            self.outside += len(left) - len(within)
            for _stream, seq in sorted(within, key=lambda one: one[1]):
                self._add(Difference(output, seq, "message", "recorded, and not computed again"))

    def _is_within(self, output: str, exposure: Exposure) -> bool:
        place = self._place(exposure)
        return all(first <= place <= last for first, last in self._spans.get(output, ()))

    def _judge(
        self, output: str, header: Header, recorded: Message | None, computed: Message
    ) -> None:
        if recorded is None:
            what = "computed, and not recorded"
            self._add(Difference(output, header.seq, "message", what))
            return
        found = next(differing(recorded, computed), None)
        if found:
            self._add(Difference(output, header.seq, *found))

    def _add(self, found: Difference) -> None:
        self.first = self.first or found
        self.different += 1


def _spans(
    plan: Plan, recording: Recording, nodes: Iterable[str]
) -> list[tuple[Place, Place]]:  # fmt: skip
    """Return between which places the outputs of these nodes were recorded.

    An output that has few messages, as of events, says nothing about where the recording began.
    """
    found = []
    for node in nodes:
        names = [f"{node}.{one}" for one in outputs_of(load_operator(plan.node(node).operator))]
        seen = [recording.messages[name] for name in names if name in recording.messages]
        most = max(map(len, seen), default=0)
        found += [_span(recording, one) for one in seen if len(one) >= most / 2]
    return found


def _span(recording: Recording, seen: Iterable[Exposure]) -> tuple[Place, Place]:
    places = [*map(in_order(recording), seen)]
    return min(places), max(places)


def differing(recorded: Any, computed: Any, where: str = "") -> Iterator[tuple[str, str]]:
    """Yield field and difference of two messages; of headers, epoch and trace do not count."""
    for one in fields(recorded):
        if type(recorded) is Header and one.name in ("epoch", "trace"):
            continue
        old, new = getattr(recorded, one.name), getattr(computed, one.name)
        name = f"{where}{one.name}"
        if isinstance(old, np.ndarray):
            yield from _arrays(name, old, new)
        elif is_dataclass(old) and type(old) is type(new):
            yield from differing(old, new, f"{name}.")
        elif old != new and not (old != old and new != new):  # nan is equal to nan here
            yield name, f"recorded {old!r}, computed {new!r}"


def _arrays(name: str, old: np.ndarray[Any, Any], new: np.ndarray[Any, Any]) -> Iterator[Any]:
    if old.dtype != new.dtype or old.shape != new.shape:
        form = f"recorded {old.dtype}{list(old.shape)}, computed {new.dtype}{list(new.shape)}"
        yield name, form
    elif old.tobytes() != new.tobytes():  # bit for bit
        unequal = old.view(f"V{old.itemsize}") != new.view(f"V{new.itemsize}")
        place = tuple(int(side) for side in np.argwhere(unequal)[0])
        count = int(np.count_nonzero(unequal))
        at = f"{name}[{', '.join(map(str, place))}]"
        yield at, f"recorded {old[place]}, computed {new[place]} ({count} of {old.size} differ)"


def is_viewer(plan: Plan, node: str) -> bool:
    """Whether a node only looks: a viewer or a recorder, which a replay leaves out."""
    edges = plan.inputs(node).values()
    return bool(edges) and all(edge.tap for edge in edges) and not is_source(plan.node(node))
