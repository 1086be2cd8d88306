"""IoU and ROI share of a running graph by time span: `Watcher`, and `Spans` to read it.

`overlap.yaml` holds the node. The watcher is told when a span begins and which class is asked for,
so that every frame is counted where it belongs.
"""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

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
    """What is asked for now; `span` is a number that goes up."""

    target: str = "ball"  # a class, as policy.target has it
    span: int = 0


@dataclass(frozen=True, kw_only=True)
class Sums:
    """Over the frames of a span in which an object of the class could be seen."""

    target: str
    frames: int = 0
    answered: int = 0  # with a box
    iou: float = 0.0  # 0 in frames without a box
    shown: float = 0.0  # share of the true box inside the ROI


class Watcher(Operator[WatcherSettings, None]):
    """Compares with any object of the class: the one overlapped most, else the one shown most."""

    percept = Input(Percept, keep="latest")
    truth = Input(Truth, keep="latest")
    roi = Input(Frame, keep="latest")
    live: ClassVar[tuple[str, ...]] = ("target", "span")

    def open(self) -> None:
        """Nothing counted."""
        self._spans: dict[int, Sums] = {}

    def on_percept_truth_roi(self, percept: Percept, truth: Truth, roi: Frame) -> None:
        """Count a frame."""
        s = self.settings
        sums = counted(self._spans.get(s.span, Sums(target=s.target)), percept, truth, roi)
        newest = sorted({*self._spans, s.span})[-2:]  # the one before is read once more
        self._spans = {n: sums if n == s.span else self._spans[n] for n in newest}

    def headline(self) -> str:
        """The last two spans; a supervisor keeps no more than a line of it."""
        return written(self._spans)


def written(spans: Mapping[int, Sums]) -> str:
    """Spans on one short line, which `read` understands.

    >>> written({7: Sums(target="ball", frames=30, answered=28, iou=15.25, shown=30.0)})
    '[[7,"ball",30,28,15.25,30.0]]'
    """
    rows = [
        (n, s.target, s.frames, s.answered, round(s.iou, 2), round(s.shown, 2))
        for n, s in sorted(spans.items())
    ]
    return json.dumps(rows, separators=(",", ":"))


def read(line: str) -> dict[int, Sums]:
    """The spans that `written` wrote.

    >>> read('[[7,"ball",30,28,15.25,30.0]]')[7].answered
    28
    """
    return {
        span: Sums(target=target, frames=frames, answered=answered, iou=iou_, shown=shown)
        for span, target, frames, answered, iou_, shown in json.loads(line)
    }


def counted(sums: Sums, percept: Percept, truth: Truth, roi: Frame) -> Sums:
    """The sums with one more frame; the same where no object of the class can be seen."""
    own = [CLASS_OF_ROLE.get(label, label) == sums.target for label in truth.labels]
    rows = np.flatnonzero(np.array(own, np.bool_) & (truth.visibility >= LEAST_VISIBLE))
    if not len(rows):
        return sums
    boxes: NDArray[np.float32] = truth.boxes[rows]
    shown = covered(boxes, np.array(roi.window, np.float32))
    overlap = iou(boxes, percept.boxes[:1])[:, 0] if len(percept.boxes) else 0 * shown
    best = int((overlap if overlap.any() else shown).argmax())
    return Sums(
        target=sums.target,
        frames=sums.frames + 1,
        answered=sums.answered + (len(percept.boxes) > 0),
        iou=sums.iou + float(overlap[best]),
        shown=sums.shown + float(shown[best]),
    )


def watched(plan: Plan) -> Plan:
    """The plan with the watcher; raises `RunError` for a graph that tracks nothing."""
    names = {node.name for node in plan.nodes}
    if missing := [name for name in NEEDED if name not in names]:
        raise RunError(f"{plan.name}: expected a node {missing[0]} to watch, got none")
    return with_nodes(plan, ADDED)


class Spans:
    """The spans of one run, as far as the watcher has told."""

    def __init__(self, supervisor: Supervisor) -> None:
        self._supervisor, self._heard = supervisor, ""
        self._sums: dict[int, Sums] = {}

    def begin(self, span: int, target: str) -> None:
        """From now on this class is asked for, and counted in this span."""
        self._set(NODE, {"span": span, "target": target})

    def ask_for(self, target: str) -> None:
        """Have the policy look for another class, as `fovea set` does."""
        self._set("policy", {"target": target})

    def read(self) -> None:
        """Take in what the watcher has told since."""
        words = self._supervisor.reports.headlines.get(NODE, "")
        if words != self._heard:
            self._heard = words
            self._sums |= read(words)

    def rows(self) -> list[dict[str, Any]]:
        """Means of every span in which something could be seen."""
        return [row(n, sums) for n, sums in sorted(self._sums.items()) if sums.frames]

    def _set(self, node: str, values: Mapping[str, Any]) -> None:
        """Change live settings while the supervisor goes on looking after its processes."""
        with ThreadPoolExecutor(1) as pool:
            asked = pool.submit(find(self._supervisor.plan.name).configure, node, values)
            while not asked.done():
                self._supervisor.tick()
            asked.result()


def row(span: int, sums: Sums) -> dict[str, Any]:
    """The means of a span.

    >>> row(3, Sums(target="ball", frames=4, answered=2, iou=1.0, shown=4.0))
    {'span': 3, 'target': 'ball', 'frames': 4, 'iou': 0.25, 'shown': 1.0, 'answered': 0.5}
    """
    figures = {name: round(getattr(sums, name) / sums.frames, 4) for name in FIGURES}
    return {"span": span, "target": sums.target, "frames": sums.frames, **figures}


FIGURES = ("iou", "shown", "answered")


def mean(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Means over the frames of several spans; empty without any."""
    frames = sum(r["frames"] for r in rows)
    if not frames:
        return {}
    return {n: round(sum(r[n] * r["frames"] for r in rows) / frames, 4) for n in FIGURES}


def ends(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The first ten spans against the last ten, all targets together and each by itself."""
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
    """IoU, ROI share and share of answers over the spans; the target is the colour below."""
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
    figure.savefig(path, dpi=140)
    pyplot.close(figure)
