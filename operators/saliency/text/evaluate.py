"""Score the detector of text: `python -m operators.saliency.text.evaluate --help`.

Runs the operator as in a graph, on pictures shrunk to a context. The confidence is chosen on
pictures for development with `--choose`, which writes it into the network's metadata.
"""

import argparse
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.judging import (
    FLOOR,
    LEAST_IOU,
    Tally,
    assigned,
    at_threshold,
    average_precision,
    best_threshold,
)
from operators.saliency.saliency import Saliency, SaliencySettings
from operators.saliency.text.quads import corners, polygon_iou, upright
from operators.saliency.text.roads import roads
from operators.saliency.text.streets import Picture, street
from operators.training.command_line import count, in_a_sentence
from operators.training.progress import each_of
from pipeline import Detections, Frame
from pipeline.boxes import iou
from pipeline.executor import Executor
from pipeline.extras import LateModule, need
from pipeline.testing import header

onnx_files: Any = LateModule("operators.training.onnx_files")  # needs the extra `train`
SEEDS = {"development": 50_000, "held-out": 70_000}
FRAMES = 5  # of a clip
KINDS = ("drives", "streets")
SHRINK = 0.25  # side of a context over that of the picture
WAYS = ("upright", "polygon")  # what is compared with the truth


def pictures_of(kind: str, first: int, number: int) -> Iterator[Picture]:
    """Pictures of one of `KINDS`: frames of clips, or streets, of seeds from `first` on."""
    if kind == "drives":
        yield from roads(range(first, first + -(-number // FRAMES)), FRAMES)
        return
    for seed in range(first, first + number):
        yield street(np.random.default_rng([seed, 0]))


def collect(pictures: Iterable[Picture], settings: SaliencySettings) -> dict[str, Tally]:
    """Run the operator over pictures; a tally for each of `WAYS`.

    Each picture is shrunk by area to a quarter; boxes are compared in its own pixels.
    """
    operator = Saliency(settings)
    executor = Executor("saliency", operator)
    operator.open()
    marks: dict[str, list[tuple[NDArray[np.float32], NDArray[np.bool_]]]] = {w: [] for w in WAYS}
    present = 0
    for seq, picture in enumerate(pictures):
        height_px, width_px = picture.pixels.shape[:2]
        small = (round(width_px * SHRINK), round(height_px * SHRINK))
        seen = cv2.resize(picture.pixels, small, interpolation=cv2.INTER_AREA)
        window = (0, 0, width_px, height_px)
        frame = Frame(header=header(seq), pixels=np.asarray(seen, np.uint8), window=window)
        found = executor.call({"frame": frame})["out"]
        assert isinstance(found, Detections)
        for way in WAYS:
            marks[way].append(_mark(found, picture, way))
        present += int((~picture.ignored).sum())
    operator.close()
    return {
        way: Tally(
            scores=np.concatenate([scores for scores, _ in rows]),
            hits=np.concatenate([hits for _, hits in rows]),
            present=present,
        )
        for way, rows in marks.items()
    }


def _mark(
    found: Detections, picture: Picture, way: str
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Scores and hits of one picture; what lies mostly on an ignored word does not count."""
    quads = quads_of(found)
    boxes, truth = upright(quads), upright(picture.quads)
    overlap = iou(boxes, truth) if way == "upright" else polygon_iou(quads, picture.quads)
    fit = np.where(overlap >= LEAST_IOU, overlap, 0)
    if len(truth):
        low = np.maximum(boxes[:, None, :2], truth[None, :, :2])
        high = np.minimum(boxes[:, None, 2:], truth[None, :, 2:])
        common = np.maximum(high - low, 0).prod(2)
        inside = common >= 0.5 * np.maximum((boxes[:, 2:] - boxes[:, :2]).prod(1), 1e-6)[:, None]
        fit = np.where(inside & picture.ignored & (fit == 0), 1e-6, fit)
    hits, counts = assigned(fit, picture.ignored)
    return found.scores[counts], hits[counts]


def quads_of(found: Detections) -> NDArray[np.float32]:
    """Corners of detections, which are turned around the centres of their boxes: (n, 4, 2)."""
    low, high = found.boxes[:, :2], found.boxes[:, 2:]
    boxes = np.concatenate([(low + high) / 2, high - low, found.angles[:, None]], 1)
    return corners(boxes.astype(np.float32))


def report(pictures: Iterable[Picture], settings: SaliencySettings) -> dict[str, dict[str, float]]:
    """Precision and recall at the network's own confidence, and average precision over all."""
    kept = list(pictures)
    working = collect(kept, settings)
    whole = collect(kept, SaliencySettings(weights=settings.weights, confidence=FLOOR))
    return {
        way: at_threshold(working[way], 0.0) | {"average_precision": average_precision(whole[way])}
        for way in WAYS
    }


def choose(weights: Path, pictures: Iterable[Picture]) -> float:
    """Find the confidence of the best F1 of upright boxes and write it into the metadata."""
    tallies = collect(pictures, SaliencySettings(weights=str(weights), confidence=FLOOR))
    limit = best_threshold(tallies["upright"])
    onnx_files.describe(weights, {"confidence": str({"text": limit})})
    return limit


@in_a_sentence()
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--choose", action="store_true", help="choose the confidence first")
    parser.add_argument("--split", choices=tuple(SEEDS), default="development")
    parser.add_argument("--kind", choices=KINDS, default="drives", help="what is scored")
    parser.add_argument("--pictures", type=count, default=200)
    parser.add_argument("--json", type=Path, help="write the figures here")
    given = parser.parse_args(words)
    if given.choose:
        need("onnx", "--choose")
    result: dict[str, object] = {"weights": given.weights.name, "pictures": given.pictures}
    if given.choose:
        drawn = pictures_of(given.kind, SEEDS["development"], given.pictures)
        result["confidence"] = choose(given.weights, each_of(drawn, "choose"))
    settings = SaliencySettings(weights=str(given.weights))
    drawn = pictures_of(given.kind, SEEDS[given.split], given.pictures)
    table = report(each_of(drawn, "score"), settings)
    result |= {"on": f"{given.split} {given.kind}", "figures": table}
    for name, row in table.items():
        print(f"{name:12}", *(f"{figure} {value:.3f}" for figure, value in row.items()))
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
