"""IoU and ROI share of a running graph by time span: `Watcher`, and `Spans` to read it.

`overlap.yaml` contains the node. Live settings give the watcher the current span and target class,
so that every frame is counted in its span.
"""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bench.outputs import write_figure
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE
from pipeline import Frame, Input, Operator, Percept, Truth
from pipeline.boxes import covered, iou
from pipeline.client.find import find
from pipeline.errors import RunError
from pipeline.graph.editing import with_nodes
from pipeline.graph.plan import Plan
from pipeline.run.supervisor import Supervisor

ADDED = Path(__file__).with_name("overlap.yaml")
NODE = "watcher"
NEEDED = ("capture", "tracker", "policy")
TEN = 10  # spans at the beginning and at the end that are compared


@dataclass(frozen=True, kw_only=True)
class WatcherSettings:
    """The current target and span; the number of the span increases."""

    target: str = "ball"  # a class, as policy.target has it
    span: int = 0


@dataclass(frozen=True, kw_only=True)
class Sums:
    """Sums over the frames of a span in which an object of the class is visible."""

    target: str
    frames: int = 0
    answered: int = 0  # with a box
    iou: float = 0.0  # 0 in frames without a box
    shown: float = 0.0  # share of the true box inside the ROI


class Watcher(Operator[WatcherSettings, None]):
    """Compares with the object of the class that it overlaps most, else the one shown most."""

    percept = Input(Percept, keep="latest")
    truth = Input(Truth, keep="latest")
    roi = Input(Frame, keep="latest")
    live: ClassVar[tuple[str, ...]] = ("target", "span")

    def open(self) -> None:
        """Start without counts."""
        self._spans: dict[int, Sums] = {}

    def on_percept_truth_roi(self, percept: Percept, truth: Truth, roi: Frame) -> None:
        """Count a frame."""
        s = self.settings
        sums = counted(self._spans.get(s.span, Sums(target=s.target)), percept, truth, roi)
        newest = sorted({*self._spans, s.span})[-2:]  # the previous one is read once more
        self._spans = {n: sums if n == s.span else self._spans[n] for n in newest}

    def headline(self) -> str:
        """Return the last two spans; a supervisor keeps no more than a line."""
        return written(self._spans)


def written(spans: Mapping[int, Sums]) -> str:
    """Return spans as one short line, which `read` parses.

    >>> written({7: Sums(target="ball", frames=30, answered=28, iou=15.25, shown=30.0)})
    '[[7,"ball",30,28,15.25,30.0]]'
    """
    rows = [
        (n, s.target, s.frames, s.answered, round(s.iou, 2), round(s.shown, 2))
        for n, s in sorted(spans.items())
    ]
    return json.dumps(rows, separators=(",", ":"))


def read(line: str) -> dict[int, Sums]:
    """Return the spans of a line of `written`.

    >>> read('[[7,"ball",30,28,15.25,30.0]]')[7].answered
    28
    """
    return {
        span: Sums(target=target, frames=frames, answered=answered, iou=iou_, shown=shown)
        for span, target, frames, answered, iou_, shown in json.loads(line)
    }


def counted(sums: Sums, percept: Percept, truth: Truth, roi: Frame) -> Sums:
    """Return the sums with one more frame; the same if no object of the class is visible."""
    own = [CLASS_OF_ROLE.get(label, label) == sums.target for label in truth.labels]
    rows = np.flatnonzero(np.array(own, np.bool_) & (truth.visibility >= LEAST_VISIBLE))
    if not len(rows):
        return sums
    shown, overlap = best_of(truth.boxes[rows], np.array(roi.window), percept.boxes)
    return Sums(
        target=sums.target,
        frames=sums.frames + 1,
        answered=sums.answered + (len(percept.boxes) > 0),
        iou=sums.iou + overlap,
        shown=sums.shown + shown,
    )


def best_of(
    boxes: NDArray[np.float32], window: NDArray[np.int_], answers: NDArray[np.float32]
) -> tuple[float, float]:
    """Return of one of `boxes` (n, 4) the share in the ROI and the IoU with the answer, if any.

    It is the one that the answer overlaps most; where it overlaps none, the one shown most.
    """
    shown = covered(boxes, window.astype(np.float32))
    overlap = iou(boxes, answers[:1])[:, 0] if len(answers) else 0 * shown
    best = int((overlap if overlap.any() else shown).argmax())
    return float(shown[best]), float(overlap[best])


def watched(plan: Plan) -> Plan:
    """Return the plan with the watcher; raises `RunError` for a graph that tracks nothing."""
    names = {node.name for node in plan.nodes}
    if missing := [name for name in NEEDED if name not in names]:
        raise RunError(f"{plan.name}: expected a node {missing[0]} to watch, got none")
    return with_nodes(plan, ADDED)


class Spans:
    """The spans of one run that the watcher has reported."""

    def __init__(self, supervisor: Supervisor) -> None:
        self._supervisor, self._heard = supervisor, ""
        self._sums: dict[int, Sums] = {}

    def begin(self, span: int, target: str) -> None:
        """Begin a span: the watcher counts frames in it, for this class."""
        self._set(NODE, {"span": span, "target": target})

    def ask_for(self, target: str) -> None:
        """Set the policy's target class, as `fovea set` does."""
        self._set("policy", {"target": target})

    def read(self) -> None:
        """Read what the watcher has reported since the last call."""
        words = self._supervisor.reports.headlines.get(NODE, "")
        if words != self._heard:
            self._heard = words
            self._sums |= read(words)

    def rows(self) -> list[dict[str, Any]]:
        """Return the means of every span with a visible object."""
        return [row(n, sums) for n, sums in sorted(self._sums.items()) if sums.frames]

    def _set(self, node: str, values: Mapping[str, Any]) -> None:
        """Change live settings while the supervisor continues to tick."""
        with ThreadPoolExecutor(1) as pool:
            asked = pool.submit(find(self._supervisor.plan.name).configure, node, values)
            while not asked.done():
                self._supervisor.tick()
            asked.result()


def row(span: int, sums: Sums) -> dict[str, Any]:
    """Return the means of a span.

    >>> row(3, Sums(target="ball", frames=4, answered=2, iou=1.0, shown=4.0))
    {'span': 3, 'target': 'ball', 'frames': 4, 'iou': 0.25, 'shown': 1.0, 'answered': 0.5}
    """
    figures = {name: round(getattr(sums, name) / sums.frames, 4) for name in FIGURES}
    return {"span": span, "target": sums.target, "frames": sums.frames, **figures}


FIGURES = ("iou", "shown", "answered")


def mean(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return means over the frames of several spans; empty without any."""
    frames = sum(r["frames"] for r in rows)
    if not frames:
        return {}
    return {n: round(sum(r[n] * r["frames"] for r in rows) / frames, 4) for n in FIGURES}


def ends(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return means of the first and the last ten spans, for all targets together and for each."""
    found: dict[str, Any] = {}
    for target in ("", *sorted({r["target"] for r in rows})):
        first, last = (
            mean([r for r in part if target in ("", r["target"])])
            for part in (rows[:TEN], rows[-TEN:])
        )
        grown = {n: round(last[n] - first[n], 4) for n in FIGURES if first and last}
        found[target or "all"] = {"first": first, "last": last, "grown": grown}
    return found


def plot(rows: Sequence[Mapping[str, Any]], path: Path, title: str) -> None:
    """Plot IoU, ROI share and share of answers over the spans; the colours below are targets."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axis = pyplot.subplots(figsize=(10, 4))
    spans = [r["span"] for r in rows]
    names = {"iou": "IoU", "shown": "share of the true box in the ROI", "answered": "with a box"}
    for name, label in names.items():
        axis.plot(spans, [r[name] for r in rows], marker=".", label=label)
    for target in sorted({r["target"] for r in rows}):
        own = [r for r in rows if r["target"] == target]
        axis.scatter([r["span"] for r in own], [-0.03] * len(own), marker="s", s=16, label=target)
    axis.set(title=title, xlabel="minute", ylim=(-0.06, 1.03))
    axis.legend(fontsize=7, ncols=3)
    figure.tight_layout()
    write_figure(figure, path)
    pyplot.close(figure)
