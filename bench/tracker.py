"""How well one object is followed through both streams, by method and by what the ROI shows.

`python -m bench.tracker --data FOLDER [--weights vitTracker.onnx]`: FOLDER is a SoccerNet sequence.
The tracker starts on the truth every 25 frames where the target is in view and runs for at most 64;
a figure is the mean over starts of the mean IoU on frames with truth. `full`: the whole picture at
full resolution; `oracle`, `centred`: a quarter-size context and a window of a quarter of the sides
around the truth or in the middle; `context`: the context alone. Prints JSON, with ms per update.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.machine import facts
from drivers.soccernet import SoccerNetSequence
from operators.tracker.correlation import Correlation
from operators.tracker.look import Picture, Streams
from operators.tracker.tracker import Follower
from operators.tracker.vittrack import VitTrack
from pipeline import Frame, Geometry
from pipeline.boxes import centres, iou, roi_window
from pipeline.testing import header

EVERY, LONGEST = 25, 64  # frames between starts, frames followed
VIEWS = ("full", "oracle", "centred", "context")
NONE = Frame(header=header(), pixels=np.zeros((0, 0, 3), np.uint8))
Window = tuple[int, int, int, int]


class Footage:
    """A whole sequence, decoded (1080p: 6 MB a frame), and its boxes by frame and id."""

    def __init__(self, folder: Path) -> None:
        source = SoccerNetSequence(path=str(folder))
        self.count = source.length or 0
        self.labels = {i: tracklet.label for i, tracklet in source.tracklets.items()}
        width, height = source.size_px
        self.geometry = Geometry(
            width_px=width, height_px=height, roi_width_px=width // 4, roi_height_px=height // 4
        )
        self.field: Window = (0, 0, width, height)
        self.whole = [source.picture(k).copy() for k in range(self.count)]
        small = (width // 4, height // 4)
        self.small = [
            cv2.resize(p, small, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
            for p in self.whole
        ]
        self.boxes: dict[tuple[int, int], NDArray[np.float32]] = {}
        for k in range(self.count):
            truth = source.truth(k)
            for i, box in zip(truth.ids, truth.boxes, strict=True) if truth else ():
                self.boxes[k, int(i)] = box

    def streams(
        self, view: str, k: int, at: NDArray[np.float32], scratch: dict[int, Picture]
    ) -> Streams:
        """What the tracker is shown of frame `k`."""
        full = Frame(header=header(k), pixels=self.whole[k], window=self.field)
        if view == "full":
            return Streams(context=NONE, roi=full, scratch=scratch)
        context = Frame(header=header(k), pixels=self.small[k], window=self.field)
        if view == "context":
            return Streams(context=context, roi=NONE, scratch=scratch)
        if view == "centred":
            at = centres(np.array(self.field, np.float32))
        window = roi_window(at, self.geometry)
        pixels = self.whole[k][window[1] : window[3], window[0] : window[2]]
        roi = Frame(header=header(k), pixels=pixels, window=window)
        return Streams(context=context, roi=roi, scratch=scratch)


def followed(
    footage: Footage, view: str, target: int, first: int, subject: Follower, spent_ms: list[float]
) -> float | None:
    """Mean IoU of one start, None without truth after it."""
    box = footage.boxes[first, target]
    at, scratch, overlaps = centres(box), dict[int, Picture](), []
    subject.start(footage.streams(view, first, at, scratch), box)
    for k in range(first + 1, min(first + LONGEST + 1, footage.count)):
        truth = footage.boxes.get((k, target))
        at = at if truth is None else centres(truth)
        streams = footage.streams(view, k, at, scratch)
        began_ns = time.perf_counter_ns()
        found, score = subject.follow(streams, box)
        spent_ms.append((time.perf_counter_ns() - began_ns) / 1e6)
        box = found if score >= subject.patience_score else box
        if truth is not None:
            overlaps.append(float(iou(box[None], truth[None])[0, 0]))
    return float(np.mean(overlaps)) if overlaps else None


def measured(footage: Footage, view: str, label: str, make: Callable[[], Follower]) -> list[float]:
    """Starts, mean IoU, ms per update (p50, p99) of all targets of one class."""
    spent_ms: list[float] = []
    subject, results = make(), []
    for target in sorted(i for i, own in footage.labels.items() if own == label):
        for first in range(0, footage.count - 1, EVERY):
            if (first, target) in footage.boxes:
                result = followed(footage, view, target, first, subject, spent_ms)
                results += [] if result is None else [result]
    low, high = np.percentile(spent_ms, (50, 99))
    return [len(results), *(round(float(v), 3) for v in (np.mean(results), low, high))]


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--labels", nargs="+", default=["ball", "main referee"])
    options = parser.parse_args()
    cv2.setNumThreads(1)
    footage = Footage(options.data)
    methods: dict[str, Callable[[], Follower]] = {"correlation": Correlation}
    if options.weights:
        methods["vittrack"] = lambda: VitTrack(options.weights, threads=1)
    table = {
        f"{method}, {label}": {view: measured(footage, view, label, make) for view in VIEWS}
        for method, make in methods.items()
        for label in options.labels
    }
    columns = ["starts", "mean IoU", "ms p50", "ms p99"]
    print(json.dumps({**facts(), "columns": columns, "figures": table}, indent=1))


if __name__ == "__main__":
    main()
