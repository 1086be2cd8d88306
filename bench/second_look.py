"""Fit what verifies a ball in the ROI: `python -m bench.second_look FOOTBALL [--json FILE]`.

FOOTBALL is a folder of labelled stills. In each, the context's detector proposes balls down to a
score of .1; full resolution around each is read by encoder and detector, as in
`graphs/tracking.yaml` at the first picture of a stream: a still has no frame before it. Logistic
regressions over the development match give the gains of `operators.verify` and of the policy
(operators/policy/candidates.py); for the matches left out the table tells how often a ball is rated
above another candidate, by each score alone and together, and by the gains in use.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import click
import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from scipy.special import logit

from bench.logistic import regressed
from bench.machine import facts
from bench.options import JSON, ROOT, Bench
from bench.prototype import table
from operators.policy.candidates import SEEN
from operators.roi_features.roi_features import Encoder, RoiEncoderSettings, verdicts
from operators.saliency import SaliencySettings
from operators.saliency.detector import Detector
from operators.saliency.example import NAMES
from operators.saliency.stills import stills
from operators.training.splits import DEVELOPMENT, TEST
from operators.verify import LEAST, OF_ENCODER, OF_SCORE, VerifySettings
from pipeline import Frame
from pipeline.boxes import centres
from pipeline.errors import DriverError
from pipeline.graph.loader import load
from pipeline.settings import build
from pipeline.testing import header
from pipeline.whole_file import write_whole

GRAPH = ROOT / "graphs" / "tracking.yaml"
USUAL = {"threads": 1, "max_objects": 400}
FAINTEST = 0.02  # score in the ROI of what is still counted
SCALE, WINDOW_PX = 4, (480, 270)
REACH_PX = VerifySettings().reach_px
NAME = VerifySettings().target
PENALTY = 0.05  # on the squares of the gains, over all candidates
RATED = {
    "score in the context": (0,), "score in the ROI": (1,), "encoder": (2,),
    "score in the ROI and encoder": (1, 2), "all three": (0, 1, 2),
}  # fmt: skip
Array = NDArray[np.float64]
Boxes = NDArray[np.float32]
IN_USE = np.array([*SEEN, OF_SCORE, OF_ENCODER])


class Looks:
    """The networks of `graphs/tracking.yaml` with its settings, on one thread.

    `confidence` is that of classes in the ROI, and `closer` the weights there, where they are not
    the graph's.
    """

    def __init__(self, confidence: Mapping[str, float], closer: str = "") -> None:
        nodes = {node.name: dict(node.settings) for node in load(GRAPH).nodes}
        context = nodes["saliency"] | USUAL
        least = nodes["closer"].get("class_confidence", {}) | confidence
        roi = nodes["closer"] | USUAL | {"class_confidence": least}
        roi |= {"weights": closer} if closer else {}
        self.context, self.roi = (
            Detector(build(SaliencySettings, values, "saliency")) for values in (context, roi)
        )
        self._encoder = Encoder(RoiEncoderSettings(threads=1))

    def rows(self, picture: NDArray[np.uint8], balls: NDArray[np.float32]) -> list[list[float]]:
        """Return context's score, ROI's score, encoder's probability and truth of candidates."""
        height, width = picture.shape[:2]
        size = width // SCALE, height // SCALE
        small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
        ((boxes, scores),) = found_by(self.context, small, [NAME])
        found = []
        for box, score in zip(boxes * SCALE, scores, strict=True):
            frame = window_around(picture, box)
            ((near, sure),) = self.finds(frame, [NAME])
            away = np.linalg.norm(centres(near) - centres(box), axis=1)
            closer = sure[away <= REACH_PX].max(initial=0)
            true = np.linalg.norm(centres(balls) - centres(box), axis=1).min()
            genuine = self.genuine(frame, box, NAME)
            found.append([float(score), float(closer), genuine, float(true <= REACH_PX)])
        return found

    def finds(self, frame: Frame, names: Sequence[str]) -> list[tuple[Boxes, Boxes]]:
        """Return boxes (n, 4) in the sensor, and scores, of what the ROI shows of each class."""
        origin = np.array(frame.window[:2] * 2, np.float32)
        found = found_by(self.roi, np.asarray(frame.pixels, np.uint8), names)
        return [(boxes + origin, scores) for boxes, scores in found]

    def genuine(self, frame: Frame, box: Boxes, name: str) -> float:
        """Return the encoder's probability that a box of the ROI (4,) is of a class."""
        _, logits = self._encoder(frame, box[None])
        return float(verdicts(logits, self._encoder.names, [name])[0])


def window_around(picture: NDArray[np.uint8], box: Boxes) -> Frame:
    """Return the ROI in whose middle a box is, or the nearest one within the picture."""
    height, width = picture.shape[:2]
    x, y = (float(side) for side in centres(box))
    left = int(np.clip(x - WINDOW_PX[0] / 2, 0, max(0, width - WINDOW_PX[0])))
    top = int(np.clip(y - WINDOW_PX[1] / 2, 0, max(0, height - WINDOW_PX[1])))
    window = (left, top, min(width, left + WINDOW_PX[0]), min(height, top + WINDOW_PX[1]))
    pixels = np.ascontiguousarray(picture[top : window[3], left : window[2]])
    return Frame(header=header(), pixels=pixels, window=window, pixel_format="rgb8")


def found_by(
    detector: Detector, picture: NDArray[np.uint8], names: Sequence[str]
) -> list[tuple[Boxes, Boxes]]:
    """Return what a detector finds of each class, best first: boxes (n, 4) and scores (n,)."""
    found, placement, _ = detector.look(picture)
    offset = np.array([placement.left_px, placement.top_px] * 2, np.float32)
    boxes = (found.boxes - offset) / np.float32(placement.gain)
    rows = [found.classes == detector.names.index(name) for name in names]
    return [(boxes[own], found.scores[own]) for own in rows]


def collected(folder: Path, matches: Sequence[str]) -> Array:
    """Return the candidates in all stills of some matches that have a ball: (n, 4)."""
    looks, found = Looks({NAME: FAINTEST}), list[list[float]]()
    some = stills(folder, only=matches)
    for file in track(some.files, "look", console=Console(stderr=True)):
        item = some.example(file)
        balls = item.boxes[item.labels == NAMES.index(NAME)]
        if len(balls):
            found += looks.rows(item.picture, balls)
    if not found:
        raise DriverError(f"{folder}: expected balls in stills of {', '.join(matches)}, got none")
    return np.array(found, np.float64)


def odds(rows: Array, columns: Sequence[int], weights: Array) -> Array:
    """Return the logarithm of the odds by bias and gains: (n,)."""
    shares = np.clip(rows[:, list(columns)], LEAST, 1 - LEAST)
    return np.asarray(weights[0] + logit(shares) @ weights[1:])


def fitted(rows: Array, columns: Sequence[int]) -> Array:
    """Return bias and gains of a logistic regression: (1 + columns,)."""
    shares = np.clip(rows[:, list(columns)], LEAST, 1 - LEAST)
    return np.roll(regressed(logit(shares), rows[:, 3] > 0, PENALTY), 1)


def area(values: Array, true: NDArray[np.bool_]) -> float:
    """Return the share of pairs in which the true one is rated higher, ties count half.

    >>> area(np.array([0.9, 0.2, 0.2]), np.array([True, True, False]))
    0.75
    """
    pairs = values[true][:, None] - values[~true][None]
    return float((pairs > 0).mean() + (pairs == 0).mean() / 2)


@click.command(cls=Bench)
@click.argument("football", type=click.Path(path_type=Path, exists=True))
@JSON
def main(football: Path, path: Path | None) -> None:
    """Fit what verifies a ball in the ROI."""
    known, rest = collected(football, DEVELOPMENT), collected(football, TEST)
    weighed = [(name, columns, fitted(known, columns)) for name, columns in RATED.items()]
    weighed.append(("all three, gains in use", RATED["all three"], IN_USE))
    rows = []
    for name, columns, weights in weighed:
        rows.append(
            {
                "rated by": name, "bias": round(float(weights[0]), 2),
                "gains": ", ".join(f"{gain:.2f}" for gain in weights[1:]),
                "development": round(area(odds(known, columns, weights), known[:, 3] > 0), 3),
                "left out": round(area(odds(rest, columns, weights), rest[:, 3] > 0), 3),
            }
        )  # fmt: skip
    Console().print(table("a ball rated above another candidate", rows))
    if path:
        counts = {
            f"{part} {what}": int(count)
            for part, found in (("development", known), ("left out", rest))
            for what, count in (("candidates", len(found)), ("balls", found[:, 3].sum()))
        }
        report = facts() | {"bench": "second_look", "data": football.name, **counts, "rows": rows}
        write_whole(path, json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
