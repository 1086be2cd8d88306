"""What a window gains the tracker: `python -m bench.consumer_gain [--json FILE]`.

The policy is trained on a utility of each window. The paper's is the gain of the frozen consumer
itself; `operators/policy/utility.py` has a stand-in made of geometry. Here the gain is measured: on
drawn matches the shipped tracker starts on the true box, with the ROI around it, and follows for a
few frames in which the ROI stays at a fixed distance from the target. Its IoU, less that of the
same start without a ROI (the context alone), is the gain at that distance. Printed by class, beside
the stand-in at the same windows and their rank correlation over windows.

Distances are from the window's centre to the target's, of half a window, the greater of both axes:
beyond 1 the window does not show the target's centre.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from scipy.stats import spearmanr
from scipy.stats import t as student

from bench.machine import facts
from bench.options import JSON, Bench
from bench.prototype import table
from drivers.commands import Window
from drivers.scenes.soccer import SoccerScene
from drivers.source import CLASS_OF_ROLE
from operators.policy.utility import gains
from operators.tracker.following import Method
from operators.tracker.look import Streams
from operators.tracker.template import Template
from pipeline import Frame, Geometry
from pipeline.boxes import centres, iou, roi_window
from pipeline.errors import SettingsError
from pipeline.testing import header
from pipeline.whole_file import write_whole

FIRST_SEED = 60_000  # clips on which rules and utilities may be chosen
DISTANCES = (0.0, 0.25, 0.5, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0)
CLASSES = ("ball", "referee", "player")
FOLLOWED, BETWEEN, VISIBLE = 16, 16, 0.5  # frames after a start, between starts; share that is seen
Box = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Try:
    """One start at one distance: means over its frames."""

    clip: int  # its seed
    kind: str  # of CLASSES
    distance: float  # asked for; the edge of the field may bring a window nearer
    gain: float  # IoU beyond that of the context alone
    stand_in: float  # the utility that geometry gives, 0..1


def window_at(box: Box, way: NDArray[np.float64], distance: float, geometry: Geometry) -> Window:
    """The window at a distance (of half a window) from a box, in a direction (2,), inside."""
    half = np.array([geometry.roi_width_px, geometry.roi_height_px]) / 2
    way = way / np.abs(way).max()
    return roi_window(np.asarray(centres(box) + way * distance * half, np.float32), geometry)


def iou_of(
    method: Method, pictures: Sequence[NDArray[np.uint8]], contexts: Sequence[Frame],
    boxes: Sequence[Box], windows: Sequence[Window | None],
) -> float:  # fmt: skip
    """Mean IoU after a start on boxes[0]; `windows` has None where there is no ROI."""
    found, overlaps = boxes[0].copy(), []
    for number, (picture, context, truth) in enumerate(zip(pictures, contexts, boxes, strict=True)):
        streams = Streams(context=context, roi=cut(picture, context, windows[number]))
        if not number:
            method.start(streams, found)
            continue
        box, score = method.follow(streams, found)
        if score >= method.patience_score:  # as in the graph: else it keeps its place
            found = box
        overlaps.append(float(iou(found[None], truth[None])[0, 0]))
    return float(np.mean(overlaps))


def cut(picture: NDArray[np.uint8], context: Frame, window: Window | None) -> Frame:
    """The ROI of a picture; without a window an empty one."""
    left, top, right, bottom = window or (0, 0, 0, 0)
    pixels = np.ascontiguousarray(picture[top:bottom, left:right])
    return Frame(header=context.header, pixels=pixels, window=(left, top, right, bottom))


def shrunk(picture: NDArray[np.uint8], scale: int) -> Frame:
    """The context of a picture, its sides divided by `scale`."""
    height, width = picture.shape[:2]
    small = cv2.resize(picture, (width // scale, height // scale), interpolation=cv2.INTER_AREA)
    return Frame(header=header(), pixels=np.asarray(small, np.uint8), window=(0, 0, width, height))


def tries(seed: int, frames: int, scale: int, method: Method) -> Iterator[Try]:
    """All starts in one drawn clip; sides of context and ROI are the field's over `scale`."""
    scene, rng = SoccerScene(seed=seed, length=frames), np.random.default_rng([seed, 1])
    pictures = [scene.picture(index) for index in range(frames)]
    truths = [scene.truth(index) for index in range(frames)]
    contexts = [shrunk(picture, scale) for picture in pictures]
    height, width = pictures[0].shape[:2]
    geometry = Geometry(
        width_px=width, height_px=height,
        roi_width_px=width // scale, roi_height_px=height // scale, step_px=2,
    )  # fmt: skip
    for start in range(0, frames - FOLLOWED, BETWEEN):
        span = slice(start, start + FOLLOWED + 1)
        for kind, boxes in seen_throughout(truths[span], rng):
            aimed = window_at(boxes[0], np.ones(2), 0, geometry)
            shown = (method, pictures[span], contexts[span], boxes)
            without = iou_of(*shown, [aimed, *[None] * FOLLOWED])
            way = rng.normal(size=2)
            for distance in DISTANCES:
                windows = [window_at(box, way, distance, geometry) for box in boxes[1:]]
                stand_in = [
                    float(gains(np.array(w, np.float32)[None, None], box[None], geometry)[0, 0])
                    for w, box in zip(windows, boxes[1:], strict=True)
                ]
                yield Try(
                    clip=seed, kind=kind, distance=distance,
                    gain=iou_of(*shown, [aimed, *windows]) - without,
                    stand_in=float(np.mean(stand_in)),
                )  # fmt: skip
    scene.close()


def seen_throughout(
    truths: Sequence[Any], rng: np.random.Generator
) -> Iterator[tuple[str, list[Box]]]:
    """One object of each class that is seen in all frames, drawn at random: its boxes."""
    boxes: dict[int, list[Box]] = {}
    kinds: dict[int, str] = {}
    for truth in truths:
        for row, number in enumerate(truth.ids if truth is not None else ()):
            if truth.visibility[row] >= VISIBLE:
                boxes.setdefault(int(number), []).append(truth.boxes[row])
                kinds[int(number)] = CLASS_OF_ROLE.get(truth.labels[row], "")
    for kind in CLASSES:
        able = [i for i, own in boxes.items() if len(own) == len(truths) and kinds[i] == kind]
        if able:
            yield kind, boxes[int(rng.choice(able))]


def rows_of(found: Sequence[Try]) -> list[dict[str, Any]]:
    """A row for each class and distance; intervals of 95 % by Student's t over clips."""
    rows = []
    for kind in CLASSES:
        for distance in DISTANCES:
            own = [t for t in found if t.kind == kind and t.distance == distance]
            if not own:
                continue
            by_clip = [np.mean([t.gain for t in own if t.clip == c]) for c in {t.clip for t in own}]
            rows.append(
                {
                    "target": kind, "distance": distance,
                    "gain in IoU": round(float(np.mean([t.gain for t in own])), 4),
                    "± over clips": round(half_interval(by_clip), 4),
                    "stand-in": round(float(np.mean([t.stand_in for t in own])), 4),
                    "starts": len(own), "clips": len(by_clip),
                }
            )  # fmt: skip
    return rows


def half_interval(values: Sequence[Any]) -> float:
    """Half of the 95 % interval of a mean; infinite for one value."""
    if len(values) < 2:
        return float("inf")
    spread = float(np.std(values, ddof=1)) / float(np.sqrt(len(values)))
    return float(student.ppf(0.975, len(values) - 1)) * spread


def correlation_of(found: Sequence[Try]) -> dict[str, float]:
    """Rank correlation of gain and stand-in over windows, by class."""
    pairs = {k: [(t.gain, t.stand_in) for t in found if t.kind == k] for k in CLASSES}
    return {
        kind: round(float(spearmanr(*zip(*own, strict=True)).statistic), 3)
        for kind, own in pairs.items()
        if len(own) > 2
    }


@click.command(cls=Bench)
@click.option("--clips", default=30, show_default=True, type=click.IntRange(2, 1000))
@click.option("--frames", default=80, show_default=True, type=click.IntRange(FOLLOWED + 1, 1000))
@click.option("--seed", default=FIRST_SEED, show_default=True, help="Of the first clip.")
@click.option("--scales", default="4,8", show_default=True, help="The field's side over the ROI's.")
@JSON
def main(clips: int, frames: int, seed: int, scales: str, path: Path | None) -> None:
    """Measure what windows gain the tracker."""
    method = Template(threads=1)
    all_rows: list[dict[str, Any]] = []
    all_ranks: dict[str, dict[str, float]] = {}
    for scale in scales_of(scales):
        found = [
            each
            for number in track(range(seed, seed + clips), "clips", console=Console(stderr=True))
            for each in tries(number, frames, scale, method)
        ]
        rows, ranks = rows_of(found), correlation_of(found)
        title = f"gain at 1/{scale**2} of the pixels, distance in half windows"
        Console().print(table(title, rows))
        Console().print(f"rank correlation of gain and stand-in over windows: {ranks}")
        all_rows += [{"pixels": f"1/{scale**2}", **row} for row in rows]
        all_ranks[f"1/{scale**2}"] = ranks
    if path:
        result = {
            "bench": "consumer_gain", **facts(), "seed": seed, "clips": clips, "frames": frames,
            "followed_frames": FOLLOWED, "rank_correlation": all_ranks, "rows": all_rows,
        }  # fmt: skip
        write_whole(path, json.dumps(result, indent=1) + "\n")


def scales_of(text: str) -> list[int]:
    """Read `--scales`; raises `SettingsError`."""
    try:
        found = [int(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(2 <= scale <= 32 for scale in found):
        raise SettingsError(f"--scales: expected numbers from 2 to 32, got {text[:100]!r}")
    return found


if __name__ == "__main__":
    main()
