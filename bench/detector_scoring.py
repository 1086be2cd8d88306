"""Marks of a detector on labelled pictures: what it found, what was there, how long it took."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency import SaliencySettings
from operators.saliency.detector import Detector
from operators.saliency.example import BALL
from operators.saliency.judging import (
    Tally,
    at_threshold,
    average_precision,
    best_threshold,
    find_hits,
)
from operators.saliency.stills import LABELS
from operators.training.stills import Labelled
from pipeline.errors import SettingsError

CENTRE = "by centre"  # a ball within six pixels of the shrunk picture
BEST = 3  # candidates for a ball among which the true one is looked for
WEAK = 0.003  # the least score of such a candidate
STEP_PX = 32
Array = NDArray[np.float32]
Found = dict[str, tuple[Array, Array]]  # by class: boxes (n, 4) and scores (n,), best first


class Looker:
    """A detector that looks at pictures shrunk by `scale`.

    A network with open sides looks at what exceeds its usual input as a whole, any other one at a
    picture that fits its input. `input_px` gives such a network another usual input; in a larger
    one pictures are enlarged. `wall_ms` and `processor_ms` keep the time of each look.
    """

    def __init__(
        self, weights: str, names: Mapping[str, str], scale: float, threads: int,
        confidence: float, input_px: tuple[int, int] = (0, 0),
    ) -> None:  # fmt: skip
        self._scale = scale
        self._own = SaliencySettings(
            weights=weights, names=names, threads=threads, input_px=input_px
        )
        self._usual = Detector(self._own)
        # of a ball weaker candidates count, too: the best three of a picture
        balls = {n: WEAK for n in self._usual.names if LABELS.get(n) == LABELS[BALL]}
        self._low = replace(
            self._own, confidence=confidence, class_confidence=balls, max_objects=300
        )
        self._detectors = {self._usual.size_px: Detector(self._low)}
        self.path, self.input_px = self._usual.path, self._usual.size_px
        self.wall_ms: list[float] = []
        self.processor_ms: list[float] = []

    def known(self, name: str) -> str:
        """The name of a class, as it is; raises `SettingsError` if the detector has no such."""
        if name not in self._usual.names:
            expected = ", ".join(self._usual.names)
            raise SettingsError(f"classes: expected one of {expected}, got {name[:40]!r}")
        return name

    def confidence_of(self, name: str) -> float:
        """The detector's own confidence of a class, also of a ball by its centre."""
        return self._usual.confidence_of(name.removesuffix(CENTRE).strip())

    def shrink(self, item: Labelled) -> Labelled:
        """A picture as the detector gets it, with boxes in its pixels."""
        height, width = item.picture.shape[:2]
        size = max(1, round(width * self._scale)), max(1, round(height * self._scale))
        if size == (width, height):
            return item
        small = cv2.resize(item.picture, size, interpolation=cv2.INTER_AREA)
        gain = np.array([size[0] / width, size[1] / height] * 2, np.float32)
        return Labelled(
            picture=np.asarray(small, np.uint8), boxes=item.boxes * gain, numbers=item.numbers
        )

    @property
    def reads_difference(self) -> bool:
        """Whether `look` needs what changed since the frame before."""
        return self._usual.reads_difference

    def look(
        self, picture: NDArray[np.uint8], difference: NDArray[np.int16] | None = None
    ) -> Found:
        """Objects by class, in the picture's pixels; `difference` as `Detector.look` takes it."""
        detector = self._for(picture.shape[1], picture.shape[0])
        began, cpu = time.perf_counter(), time.process_time()
        found, at, _ = detector.look(picture, difference)
        self.wall_ms.append((time.perf_counter() - began) * 1e3)
        self.processor_ms.append((time.process_time() - cpu) * 1e3)
        offset = np.array([at.left_px, at.top_px] * 2, np.float32)
        boxes = (found.boxes - offset) / np.float32(at.gain)
        rows = [(name, found.classes == row) for row, name in enumerate(detector.names)]
        return {name: (boxes[mine], found.scores[mine]) for name, mine in rows}

    def _for(self, width: int, height: int) -> Detector:
        usual = self._usual.size_px
        if not self._usual.open_sides or (width <= usual[0] and height <= usual[1]):
            return self._detectors[usual]
        size = -(-width // STEP_PX) * STEP_PX, -(-height // STEP_PX) * STEP_PX
        if size not in self._detectors:
            self._detectors[size] = Detector(replace(self._low, input_px=size))
            self.input_px = size
        return self._detectors[size]


@dataclass(kw_only=True)
class Marks:
    """Hits of each class in some pictures; those of several can be added."""

    scores: dict[str, list[Array]] = field(default_factory=dict)
    hits: dict[str, list[NDArray[np.bool_]]] = field(default_factory=dict)
    present: dict[str, int] = field(default_factory=dict)
    among: list[bool] = field(default_factory=list)  # of each ball: among the best candidates

    def add(self, looker: Looker, item: Labelled, wanted: Mapping[int, str]) -> None:
        """Look at a picture and mark what is found."""
        small = looker.shrink(item)
        self.take(looker.look(small.picture), small, wanted)

    def take(self, found: Found, small: Labelled, wanted: Mapping[int, str]) -> None:
        """Mark what was found in a picture, in the pixels of its boxes."""
        for name in dict.fromkeys(wanted.values()):
            numbers = [number for number, of in wanted.items() if of == name]
            truth = small.boxes[np.isin(small.numbers, numbers)]
            self._mark(name, found[name], truth, by_centre=False)
            if LABELS.get(name) == LABELS[BALL]:
                self._mark(f"{name} {CENTRE}", found[name], truth, by_centre=True)
                if len(truth):
                    self.among.append(among_best(found[name], truth))

    def _mark(self, key: str, found: tuple[Array, Array], truth: Array, by_centre: bool) -> None:
        boxes, scores = found
        hits, _ = find_hits(boxes, truth, np.zeros(len(truth), np.bool_), by_centre=by_centre)
        self.scores.setdefault(key, []).append(scores)
        self.hits.setdefault(key, []).append(hits)
        self.present[key] = self.present.get(key, 0) + len(truth)

    def __add__(self, other: "Marks") -> "Marks":
        keys = dict.fromkeys([*self.scores, *other.scores])
        return Marks(
            scores={k: self.scores.get(k, []) + other.scores.get(k, []) for k in keys},
            hits={k: self.hits.get(k, []) + other.hits.get(k, []) for k in keys},
            present={k: self.present.get(k, 0) + other.present.get(k, 0) for k in keys},
            among=self.among + other.among,
        )

    @property
    def tallies(self) -> dict[str, Tally]:
        """All pictures together."""
        return {
            key: Tally(
                scores=np.concatenate(self.scores[key]),
                hits=np.concatenate(self.hits[key]),
                present=self.present[key],
            )
            for key in self.scores
        }


def among_best(found: tuple[Array, Array], truth: Array) -> bool:
    """Whether a true ball's centre is near one of the best candidates'."""
    boxes = found[0][:BEST]
    hits, _ = find_hits(boxes, truth, np.zeros(len(truth), np.bool_), by_centre=True)
    return bool(hits.any())


def thresholds_of(tallies: Mapping[str, Tally]) -> dict[str, float]:
    """The confidence of the greatest F1 of each class; of a ball, by its centre.

    The box of a ball of three pixels need only be off by one to overlap it too little.
    """
    best = {name: best_threshold(tally) for name, tally in tallies.items()}
    return {name: best.get(f"{name} {CENTRE}", value) for name, value in best.items()}


def figures(marks: Marks, confidence: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the row of each class."""
    rows = []
    for name, tally in marks.tallies.items():
        at = at_threshold(tally, confidence[name])
        row = {
            "class": name,
            "present": tally.present,
            "confidence": round(confidence[name], 3),
            "precision": round(at["precision"], 3),
            "recall": round(at["recall"], 3),
            "average_precision": round(average_precision(tally), 3),
            "best_confidence": best_threshold(tally),
        }
        if name.endswith(CENTRE) and marks.among:
            row[f"among_{BEST}"] = round(sum(marks.among) / len(marks.among), 3)
        rows.append(row)
    return rows


def spread(times_ms: Sequence[float]) -> dict[str, float]:
    """Return median, 5th and 95th percentile."""
    low, middle, high = np.quantile(times_ms, (0.05, 0.5, 0.95))
    return {"median": round(middle, 1), "p05": round(low, 1), "p95": round(high, 1)}
