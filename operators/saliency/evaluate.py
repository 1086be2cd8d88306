"""Score a detector on held-out scenes: `python -m operators.saliency.evaluate --help`.

Runs the operator as in a graph. Thresholds are chosen on validation scenes, or on the stills for
development of a folder (`--stills`), with `--choose`, which writes them into the network's
metadata; reported figures come from test scenes, or from a SoccerNet sequence (`--data`).
"""

import argparse
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.datasets.sequence import span
from drivers.datasets.soccernet import SoccerNetSequence
from drivers.scenes.soccer import SoccerScene
from operators.saliency.example import BALL, CONTEXT_PX, NAMES, Example, resized
from operators.saliency.judging import (
    FLOOR,
    Tally,
    at_threshold,
    average_precision,
    best_threshold,
    find_hits,
)
from operators.saliency.movement import frame_before
from operators.saliency.render import FULL_PX, RATE_HZ, example, moments
from operators.saliency.saliency import SHIPPED, Detector, Saliency, SaliencySettings
from operators.saliency.stills import stills
from operators.training.command_line import count, in_a_sentence
from operators.training.progress import each_of
from operators.training.splits import DEVELOPMENT
from pipeline import Detections, Frame, SettingsError
from pipeline.executor import Executor
from pipeline.extras import LateModule, need
from pipeline.testing import header

onnx_files: Any = LateModule("operators.training.onnx_files")  # needs the extra `train`
SEEDS = {"validation": range(50_000, 50_030), "test": range(60_000, 60_040)}
SPAN = 900  # frames of each scene


def collect(
    examples: Iterable[Example], settings: SaliencySettings, side_share: float = 1.0
) -> dict[str, Tally]:
    """Run the operator over examples; a tally for each class, and `ball centre`.

    `side_share`: side of the pictures it gets over that of the examples: a leaner context.
    """
    operator = Saliency(settings)
    executor, reads_difference = Executor("saliency", operator), settings.detector.reads_difference
    operator.open()
    marks: dict[str, list[tuple[NDArray[np.float32], NDArray[np.bool_]]]] = {}
    present = dict.fromkeys((*NAMES, f"{BALL} centre"), 0)
    for seq, item in enumerate(examples):
        height_px, width_px = item.picture.shape[:2]
        seen = shrunk(item.picture, side_share)
        window = (0, 0, width_px, height_px)
        operator.on_stream(header(2 * seq))  # the next example shows something else
        if reads_difference and (before := frame_before(item)) is not None:
            earlier = Frame(
                header=header(2 * seq), pixels=shrunk(before, side_share), window=window,
                pixel_format="grey8",
            )  # fmt: skip
            executor.call({"frame": earlier})
        frame = Frame(header=header(2 * seq + 1), pixels=seen, window=window)
        found = executor.call({"frame": frame})["out"]
        assert isinstance(found, Detections)
        for key in present:
            scores, hits = _mark(found, item, key)
            marks.setdefault(key, []).append((scores, hits))
            of_class = item.labels == NAMES.index(key.split()[0])
            present[key] += int((of_class & ~item.ignored).sum())
    operator.close()
    return {
        key: Tally(
            scores=np.concatenate([scores for scores, _ in rows]),
            hits=np.concatenate([hits for _, hits in rows]),
            present=present[key],
        )
        for key, rows in marks.items()
    }


def shrunk(picture: NDArray[np.uint8], side_share: float) -> NDArray[np.uint8]:
    """What a sensor reads that averages over larger areas; the same picture for 1."""
    height_px, width_px = (max(1, round(length * side_share)) for length in picture.shape[:2])
    small = cv2.resize(picture, (width_px, height_px), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def _mark(
    found: Detections, item: Example, key: str
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    name = key.split()[0]
    mine = np.array([found.names[label] == name for label in found.labels], np.bool_)
    theirs = item.labels == NAMES.index(name)
    hits, counts = find_hits(
        found.boxes[mine],
        item.boxes[theirs],
        item.ignored[theirs],
        by_centre=key.endswith("centre"),
    )
    return found.scores[mine][counts], hits[counts]


def scenes(seeds: Iterable[int], count: int) -> Iterator[Example]:
    """Well-spaced pictures of procedural scenes."""
    for seed in seeds:
        scene = SoccerScene(size_px=FULL_PX, rate_hz=RATE_HZ, seed=seed)
        yield from (example(scene, index) for index in moments(seed, count, SPAN))
        scene.close()


def development(folder: Path) -> Iterator[Example]:
    """The stills of a folder that are for development, as a context shows them."""
    found = stills(folder, only=DEVELOPMENT)
    for file in found.files:
        yield resized(found.example(file), CONTEXT_PX)


def sequence(folder: Path, stride: int, frames: tuple[int, int]) -> Iterator[Example]:
    """Every `stride`-th picture of frames A-B (from 1; 0: to the end) of a SoccerNet sequence."""
    source = SoccerNetSequence(path=str(folder))
    last = min(frames[1] or (source.length or 0), source.length or 0)
    if not 1 <= frames[0] <= last:
        raise SettingsError(f"frames: expected 1 to {source.length}, got {frames[0]}-{frames[1]}")
    yield from (example(source, index) for index in range(frames[0] - 1, last, stride))
    source.close()


def report(
    examples: Iterable[Example], settings: SaliencySettings, side_share: float = 1.0
) -> dict[str, dict[str, float]]:
    """Figures at the operating point of `settings`, and average precision over all confidences."""
    kept = list(examples)
    working = collect(kept, settings, side_share)
    low = SaliencySettings(
        weights=settings.weights, names=settings.names, confidence=FLOOR, threads=settings.threads
    )
    whole = collect(kept, low, side_share)
    table = {
        key: at_threshold(tally, 0.0) | {"average_precision": average_precision(whole[key])}
        for key, tally in working.items()
    }
    if there := [table[name] for name in NAMES if table[name]["present"]]:
        table["macro"] = {
            figure: float(np.mean([row[figure] for row in there]))
            for figure in ("precision", "recall", "average_precision")
        }
    return table


def choose(
    weights: Path, examples: Iterable[Example], threads: int, side_share: float = 1.0
) -> dict[str, float]:
    """Find each class's best confidence and write it into the network's metadata."""
    low = SaliencySettings(weights=str(weights), confidence=FLOOR, threads=threads)
    tallies = collect(examples, low, side_share)
    limits = {name: best_threshold(tallies[name]) for name in NAMES}
    # the box of a ball of three pixels need only be off by one to overlap it too little
    limits[BALL] = best_threshold(tallies[f"{BALL} centre"])
    onnx_files.describe(weights, {"confidence": str(limits)})
    return limits


def share(text: str) -> float:
    """Above 0 to 1."""
    value = float(text)
    if not 0 < value <= 1:
        raise argparse.ArgumentTypeError(f"expected above 0 to 1, got {text}")
    return value


@in_a_sentence()
def main(words: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--weights", type=Path, default=SHIPPED)
    parser.add_argument("--names", type=json.loads, default={}, help='{"0": "player", ...}')
    parser.add_argument("--data", type=Path, help="a SoccerNet sequence instead of scenes")
    parser.add_argument("--stride", type=count, default=5, help="with --data: every n-th frame")
    parser.add_argument("--frames", type=span, default=(1, 0), help="with --data: A-B, from 1")
    parser.add_argument("--moments", type=count, default=12, help="pictures of each scene")
    parser.add_argument("--choose", action="store_true", help="choose thresholds, then score")
    parser.add_argument("--stills", type=Path, help="with --choose: those for development here")
    parser.add_argument("--threads", type=count, default=2)
    parser.add_argument(
        "--side-share", type=share, default=1.0,
        help="side of the context over that of 480x270; with --choose thresholds are for it too",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, help="write the figures here")
    given = parser.parse_args(words)
    if given.stills and not given.choose:  # else the figures would be taken for those of the stills
        parser.error("--stills: expected --choose as well; figures are of scenes, or of --data")
    if given.choose:
        need("onnx", "--choose")
    settings = SaliencySettings(
        weights=str(given.weights), names=given.names, threads=given.threads
    )
    Detector(settings)  # refused now, and not after the drawing
    result: dict[str, object] = {"weights": given.weights.name, "side_share": given.side_share}
    if given.choose:
        drawn = scenes(SEEDS["validation"], given.moments)
        validation = each_of(development(given.stills) if given.stills else drawn, "choose")
        result["thresholds"] = choose(given.weights, validation, given.threads, given.side_share)
    test = scenes(SEEDS["test"], given.moments)
    source = sequence(given.data, given.stride, given.frames) if given.data else test
    table = report(each_of(source, "score"), settings, given.side_share)
    result |= {"on": given.data.name if given.data else "test scenes", "figures": table}
    for name, row in table.items():
        print(f"{name:12}", *(f"{figure} {value:.3f}" for figure, value in row.items()))
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
