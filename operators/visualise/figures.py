"""Figures of the loop: latency, pixels read, how much of the target the ROI shows, its IoU."""

from collections import deque
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.boxes import covered_by, iou
from pipeline.messages import Frame, Header, Percept, Scanpath, Tracks, Truth

RECENT_FRAMES = 150  # that percentiles are taken over
REMEMBERED = 64  # frames whose windows and truth are kept until tracks and answers arrive
BUDGET_FRAMES = {"p50": 1, "p99": 2}  # of the loop, in periods of the source
LEAST_STEPS = 3  # between frames, of which the period is the median
SAME_IOU = 0.3  # from which the policy's box is on a true object
NOBODY = -1
T = TypeVar("T")


class LoopLatency:
    """From the picture to the sensor command made from it, over the last frames, in ms."""

    def __init__(self) -> None:
        self._ages: deque[float] = deque(maxlen=RECENT_FRAMES)
        self._ready: deque[tuple[int, int]] = deque(maxlen=RECENT_FRAMES)  # seq, stamp in ns

    def add(self, header: Header) -> None:
        """Take a sensor command; it counts if picture and command are timed by one clock."""
        self._ready.append((header.seq, header.stamp_ns))
        if header.trace and header.clock == "monotonic":
            self._ages.append((header.trace[-1].done_ns - header.stamp_ns) / 1e6)

    def figures(self) -> dict[str, float]:
        """Return percentiles and their budgets by name; empty before the first frame."""
        if not self._ages:
            return {}
        ages = np.array(self._ages)
        found = {name: float(np.percentile(ages, int(name[1:]))) for name in BUDGET_FRAMES}
        if period_ms := self._period_ms():
            found |= {f"budget_{name}": n * period_ms for name, n in BUDGET_FRAMES.items()}
        return found

    def _period_ms(self) -> float:
        steps = [(t - s) / (b - a) for (a, s), (b, t) in pairwise(self._ready) if b > a]
        return float(np.median(steps)) / 1e6 if len(steps) >= LEAST_STEPS else 0.0


def stages(header: Header) -> dict[str, float]:
    """Return how long after the picture each stage had finished, in ms: as in a stack, the
    distance between two of them is what the later one took, with its waiting and transport.
    """
    if header.clock != "monotonic":
        return {}
    return {span.stage: (span.done_ns - header.stamp_ns) / 1e6 for span in header.trace}


def latencies(header: Header) -> dict[str, float]:
    """What the last stage did with this exposure, in ms: name -> value; empty without a trace.

    `age` is the time since the picture was ready, given only where both are one clock.
    """
    if not header.trace:
        return {}
    span = header.trace[-1]
    shown = {"handler_ms": span.handler_ns / 1e6, "sched_delay_ms": span.scheduling_delay_ns / 1e6}
    if header.clock == "monotonic":
        shown["age_ms"] = (span.done_ns - header.stamp_ns) / 1e6
    if len(header.trace) > 1:
        shown["hop_ms"] = (span.received_ns - header.trace[-2].done_ns) / 1e6
    return {f"{span.stage}/{name}": value for name, value in shown.items()}


class PixelsRead:
    """The share of the sensor's pixels that each exposure reads, beside what it may read."""

    def __init__(self) -> None:
        self._context_px: tuple[int, int] = (-1, 0)  # seq, pixels
        self._windows: dict[str, int] = {}  # input -> pixels read in the frame of `_seq`
        self._seq = -1

    def add_context(self, context: Frame) -> None:
        """Take the context of an exposure."""
        width, height = context.size_px
        self._context_px = context.header.seq, width * height

    def add_roi(self, name: str, roi: Frame) -> dict[str, float]:
        """Take one window of an exposure; return percents of the sensor, empty if not known."""
        if roi.header.seq != self._seq:
            self._seq = roi.header.seq
            self._windows = dict.fromkeys(self._windows, 0)
        self._windows[name] = int(np.prod(roi.size_px))
        whole = roi.header.geometry.width_px * roi.header.geometry.height_px
        seq, context_px = self._context_px
        if not whole or seq < 0:
            return {}
        window_px = roi.header.geometry.roi_width_px * roi.header.geometry.roi_height_px
        most = context_px + window_px * len(self._windows)
        read = context_px + sum(self._windows.values())
        return {"read": 100 * read / whole, "budget": 100 * most / whole}


class Target:
    """What the policy looks at, and the true object that it is on, if the truth is known.

    The true object is the one that overlapped the target's box last, by `SAME_IOU` at least.
    """

    def __init__(self) -> None:
        self.id = NOBODY  # of a track
        self._true_id = NOBODY
        self._windows: dict[int, dict[str, tuple[int, int, int, int]]] = {}  # by seq and input
        self._truths: dict[int, Truth] = {}

    def add_roi(self, name: str, roi: Frame) -> None:
        """Remember a window until the tracks of its exposure arrive."""
        if roi.pixels.size:
            self._windows.setdefault(roi.header.seq, {})[name] = roi.window
        forget(self._windows, roi.header.seq)

    def add_truth(self, truth: Truth) -> None:
        """Remember the true boxes until tracks and answers of their exposure arrive."""
        self._truths[truth.header.seq] = truth
        forget(self._truths, truth.header.seq)

    def add_scanpath(self, scanpath: Scanpath) -> None:
        """Take the object that the policy chose for the next frame; a mere place is no object."""
        if len(scanpath.choice):
            self.id = int(scanpath.choice[0])

    def row(self, tracks: Tracks) -> int:
        """Return the target's row among the tracks; -1 when it is not there."""
        rows = np.flatnonzero(tracks.ids == self.id)
        return int(rows[0]) if self.id >= 0 and len(rows) else NOBODY

    def in_roi(self, tracks: Tracks) -> float | None:
        """Return the share of the target inside the ROI of this exposure; None if not known."""
        seq, row = tracks.header.seq, self.row(tracks)
        box = tracks.boxes[row : row + 1, -1] if row >= 0 else tracks.boxes[:0, -1]
        truth = self._truths.get(seq)
        if truth is not None and len(truth.boxes) and len(box):
            overlap = iou(truth.boxes, box)[:, 0]
            if overlap.max() >= SAME_IOU:
                self._true_id = int(truth.ids[overlap.argmax()])
        true_box = self._true_box(seq)
        box = true_box if len(true_box) else box
        if not len(box) or seq not in self._windows:
            return None
        windows = np.array(list(self._windows[seq].values()), np.float32)
        return float(covered_by(box, windows)[0])

    def overlap(self, percept: Percept) -> float | None:
        """Return the IoU of an answer with the truth, 0 for none; None without a true object."""
        true_box = self._true_box(percept.header.seq)
        if not len(true_box):
            return None
        return float(iou(true_box, percept.boxes[:1])[0, 0]) if len(percept.boxes) else 0.0

    def _true_box(self, seq: int) -> NDArray[np.float32]:
        truth = self._truths.get(seq)
        if truth is None:
            return np.zeros((0, 4), np.float32)
        return np.asarray(truth.boxes[truth.ids == self._true_id][:1], np.float32)


def forget(found: dict[int, T], seq: int) -> None:
    """Remove all but the newest `REMEMBERED` frames."""
    for old in [k for k in found if k <= seq - REMEMBERED]:
        del found[old]
