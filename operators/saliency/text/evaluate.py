"""Score the detector of text: `python -m operators.saliency.text.evaluate --help`.

Runs the operator as in a graph, on pictures shrunk to a context. The confidence is chosen on
pictures of all kinds for development with `--choose`, which writes it into the network's metadata.
"""

import argparse
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.detector import TEXT, Detector
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
from operators.saliency.text.photographs import labelled_in, part_of, photographs_in
from operators.saliency.text.quads import corners, polygon_iou, upright
from operators.saliency.text.roads import roads
from operators.saliency.text.streets import FULL_PX, Picture, street
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
DRAWN = ("drives", "streets")
PHOTOGRAPHS = "photographs"  # boards drawn upon them
REDUCE = 4  # side of the picture over that of its context
STRIDE = 32  # sides of the input are multiples of it
MOST = 300  # detections of a context
WAYS = ("upright", "polygon")  # what is compared with the truth


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """A context, and the words of the whole picture."""

    frame: Frame
    quads: NDArray[np.float32]  # (n, 4, 2) corners, pixels of the whole picture
    ignored: NDArray[np.bool_]  # (n,) may be found or not


def looks(
    kind: str,
    first: int,
    number: int,
    size_px: tuple[int, int] = FULL_PX,
    stills: Sequence[Path] = (),
) -> Iterator[Look]:
    """Contexts of a kind: frames of drives, or boards in streets or upon `stills`.

    Their seeds begin with `first`.
    """
    if kind == "drives":
        seeds = range(first, first + -(-number // FRAMES))
        for seq, seen in enumerate(roads(seeds, FRAMES, size_px, REDUCE)):
            yield look(seen, seq, size_px)
        return
    for seq in range(number):
        rng = np.random.default_rng([first + seq, 0])
        behind = part_of(stills[int(rng.integers(len(stills)))], rng) if stills else None
        yield look(context_of(street(rng, behind)), seq, FULL_PX)


def context_of(whole: Picture) -> Picture:
    """The context of a picture of `FULL_PX`; its corners stay in pixels of the whole one."""
    size = (FULL_PX[0] // REDUCE, FULL_PX[1] // REDUCE)
    small = cv2.resize(whole.pixels, size, interpolation=cv2.INTER_AREA)
    return replace(whole, pixels=np.asarray(small, np.uint8))


def look(seen: Picture, seq: int, size_px: tuple[int, int]) -> Look:
    """A shrunk picture as a frame; its corners are in pixels of `size_px`."""
    frame = Frame(header=header(seq), pixels=seen.pixels, window=(0, 0, *size_px))
    return Look(frame=frame, quads=seen.quads, ignored=seen.ignored)


def settings_for(weights: str, size_px: tuple[int, int], confidence: float) -> SaliencySettings:
    """Settings with which a context of a picture of this size is read at its own resolution."""
    width, height = (-(-side // REDUCE // STRIDE) * STRIDE for side in size_px)
    return SaliencySettings(
        weights=weights, input_px=(width, height), confidence=confidence, max_objects=MOST
    )


def collect(seen: Iterable[Look], settings: SaliencySettings) -> dict[str, Tally]:
    """Run the operator over contexts; a tally for each of `WAYS`."""
    operator = Saliency(settings)
    executor = Executor("saliency", operator)
    operator.open()
    marks: dict[str, list[tuple[NDArray[np.float32], NDArray[np.bool_]]]] = {w: [] for w in WAYS}
    present = 0
    for item in seen:
        found = executor.call({"frame": item.frame})["out"]
        assert isinstance(found, Detections)
        for way in WAYS:
            marks[way].append(mark(found, item, way))
        present += int((~item.ignored).sum())
    operator.close()
    return {
        way: Tally(
            scores=np.concatenate([scores for scores, _ in rows]),
            hits=np.concatenate([hits for _, hits in rows]),
            present=present,
        )
        for way, rows in marks.items()
    }


def mark(found: Detections, item: Look, way: str) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Scores and hits of one context; what lies mostly on an ignored word does not count."""
    quads = quads_of(found)
    boxes, truth = upright(quads), upright(item.quads)
    overlap = iou(boxes, truth) if way == "upright" else polygon_iou(quads, item.quads)
    fit = np.where(overlap >= LEAST_IOU, overlap, 0)
    if len(truth):
        low = np.maximum(boxes[:, None, :2], truth[None, :, :2])
        high = np.minimum(boxes[:, None, 2:], truth[None, :, 2:])
        common = np.maximum(high - low, 0).prod(2)
        inside = common >= 0.5 * np.maximum((boxes[:, 2:] - boxes[:, :2]).prod(1), 1e-6)[:, None]
        fit = np.where(inside & item.ignored & (fit == 0), 1e-6, fit)
    hits, counts = assigned(fit, item.ignored)
    return found.scores[counts], hits[counts]


def quads_of(found: Detections) -> NDArray[np.float32]:
    """Corners of detections, which are turned around the centres of their boxes: (n, 4, 2)."""
    low, high = found.boxes[:, :2], found.boxes[:, 2:]
    boxes = np.concatenate([(low + high) / 2, high - low, found.angles[:, None]], 1)
    return corners(boxes.astype(np.float32))


def report(
    seen: Iterable[Look],
    weights: str,
    size_px: tuple[int, int] = FULL_PX,
    confidence: float = 0.0,
) -> dict[str, dict[str, float]]:
    """Precision and recall at a confidence, 0: the network's own, and average precision."""
    kept = list(seen)
    working = collect(kept, settings_for(weights, size_px, confidence))
    whole = collect(kept, settings_for(weights, size_px, FLOOR))
    return {
        way: at_threshold(working[way], 0.0) | {"average_precision": average_precision(whole[way])}
        for way in WAYS
    }


def choose(weights: Path, seen: Iterable[Look]) -> float:
    """Find the confidence of the best F1 of upright boxes and write it into the metadata."""
    tallies = collect(seen, settings_for(str(weights), FULL_PX, FLOOR))
    limit = best_threshold(tallies["upright"])
    onnx_files.describe(weights, {"confidence": str({"text": limit})})
    return limit


def size(text: str) -> tuple[int, int]:
    """Width and height as 1280x720, sides that `REDUCE` divides; for argparse."""
    width, _, height = text.partition("x")
    sides = int(width), int(height)
    if min(sides) < REDUCE or any(side % REDUCE for side in sides):
        raise argparse.ArgumentTypeError(f"expected sides that {REDUCE} divides, got {text}")
    return sides


@in_a_sentence()
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--weights", type=Path, default=TEXT)
    parser.add_argument("--choose", action="store_true", help="choose the confidence first")
    parser.add_argument("--split", choices=tuple(SEEDS), default="development")
    kinds = (*DRAWN, PHOTOGRAPHS)
    parser.add_argument("--kind", choices=kinds, default="drives", help="what is scored")
    parser.add_argument("--stills", type=Path, help="folder of the photographs (.jpg)")
    parser.add_argument("--labelled", type=Path, help="score all labelled photographs of a folder")
    parser.add_argument("--pictures", type=count, default=200)
    parser.add_argument("--size", type=size, default=FULL_PX, help="of drives, as 1280x720")
    parser.add_argument("--confidence", type=float, default=0.0, help="0: the network's own")
    parser.add_argument("--json", type=Path, help="write the figures here")
    given = parser.parse_args(words)
    need("PIL", "text")
    if (given.kind == PHOTOGRAPHS) != (given.stills is not None):
        parser.error(f"--stills: --kind {PHOTOGRAPHS} and a folder go together")
    stills = photographs_in(given.stills, given.split) if given.stills else []
    weights = str(given.weights)
    Detector(settings_for(weights, given.size, given.confidence))  # refused before the drawing
    result: dict[str, object] = {"weights": given.weights.name, "pictures": given.pictures}
    if given.choose:
        need("onnx", "--choose")
        parts = (looks(kind, SEEDS["development"], given.pictures) for kind in DRAWN)
        result["confidence"] = choose(given.weights, each_of(chain.from_iterable(parts), "choose"))
    seen: Iterator[Look]
    if given.labelled:
        contexts = map(context_of, labelled_in(given.labelled))
        seen = (look(context, seq, FULL_PX) for seq, context in enumerate(contexts))
        on = given.labelled.name
    else:
        seen = looks(given.kind, SEEDS[given.split], given.pictures, given.size, stills)
        on = f"{given.split} {given.kind}"
    table = report(each_of(seen, "score"), weights, given.size, given.confidence)
    result |= {"on": on, "size_px": given.size, "figures": table}
    for name, row in table.items():
        print(f"{name:12}", *(f"{figure} {value:.3f}" for figure, value in row.items()))
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
