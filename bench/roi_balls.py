"""Is the ball rated best of what a ROI shows? `python -m bench.roi_balls NAME=FILE …`.

Around each ball of a SoccerNet folder, by whether it lies still, is free or carried
(bench/tracking/targets.py), and of the stills left out of trainings, a window of 480x270 pixels is
cut out at full resolution, off the ball's middle at random. Each detector reads it at the width of
its input, as the `closer` of graphs/tracking.yaml does. Prints in how many windows the ball is
rated above all else, also with left and right exchanged, which shows as much of it, and above how
many of the best false finds of all windows (`pairs`).
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from bench.ball_candidates import truths_of
from bench.detector import of_split
from bench.detector_scoring import Found, Looker
from bench.detector_versions import named
from bench.machine import facts
from bench.options import JSON, Bench
from bench.prototype import table
from bench.second_look import WINDOW_PX, area
from bench.tracking.targets import targets
from drivers.datasets.soccernet import SoccerNetSequence
from drivers.source import LEAST_VISIBLE
from operators.saliency.example import BALL, NAMES
from operators.saliency.judging import FLOOR
from operators.saliency.stills import stills
from operators.training.stills import Labelled
from pipeline.boxes import centres
from pipeline.errors import DriverError, SettingsError
from pipeline.whole_file import write_whole

OFF_PX = (150, 70)  # most by which the ball is beside the middle of its window: x, y
NEAR_PX = 4.0  # of full resolution, beyond half of its width, where a find is still the ball
OF_EACH = 2  # windows around each ball of a still
Array = NDArray[np.float32]


def window(picture: NDArray[np.uint8], ball: Array, rng: np.random.Generator) -> Labelled:
    """Return a part of a picture around a ball (4,), with the ball in its pixels."""
    sides = np.array(picture.shape[1::-1])
    corner = centres(ball) - np.array(WINDOW_PX) / 2 + rng.uniform(-1, 1, 2) * OFF_PX
    left, top = np.clip(corner, 0, np.maximum(sides - WINDOW_PX, 0)).astype(int).tolist()
    part = picture[top : top + WINDOW_PX[1], left : left + WINDOW_PX[0]]
    return Labelled(
        picture=np.ascontiguousarray(part),
        boxes=ball[None] - np.array([left, top] * 2, np.float32),
        numbers=np.array([NAMES.index(BALL)]),
    )


def of_sequence(folder: Path, every: int, seed: int) -> Iterator[tuple[str, Labelled]]:
    """Yield state and window of the visible balls of a SoccerNet folder."""
    rng, source = np.random.default_rng(seed), SoccerNetSequence(path=str(folder))
    width_px = source.size_px[0]
    balls = targets(truths_of(source), [BALL], players=1, seed=0, width_px=width_px)
    if not balls:
        raise DriverError(f"{folder}: expected a ball in at least a tenth of the frames, got none")
    for k in track(
        range(0, len(balls[0].visible), every), folder.name, console=Console(stderr=True)
    ):
        if balls[0].visible[k] >= LEAST_VISIBLE:
            yield balls[0].state[k], window(source.picture(k), balls[0].boxes[k], rng)
    source.close()


def of_stills(folder: Path, seed: int) -> Iterator[tuple[str, Labelled]]:
    """Yield the windows around the balls of the stills left out of trainings."""
    rng, known = np.random.default_rng(seed), stills(folder)
    for file in track(of_split(folder, "test"), folder.name, console=Console(stderr=True)):
        still = known.example(file)
        for ball in still.boxes[still.labels == NAMES.index(BALL)]:
            for _ in range(OF_EACH):
                yield "left out", window(still.picture, ball, rng)


def mirrored(part: Labelled) -> Labelled:
    """Return a window with left and right exchanged."""
    width = part.picture.shape[1]
    ends = part.boxes[:, [2, 1, 0, 3]] * np.array([-1, 1, -1, 1], np.float32)
    return replace(
        part,
        picture=np.ascontiguousarray(part.picture[:, ::-1]),
        boxes=ends + np.array([width, 0, width, 0], np.float32),
    )


def best_scores(found: Found, ball: Array, gain: float = 1.0) -> tuple[float, float]:
    """Return the best score of a find at the ball (4,), and of one elsewhere; 0 without one.

    `gain` is the scale of what was found over that of the window with the ball.
    """
    boxes, scores = found[BALL]
    apart = np.linalg.norm(centres(boxes) / gain - centres(ball), axis=1)
    near = apart < (ball[2] - ball[0]) / 2 + NEAR_PX
    return float(scores[near].max(initial=0)), float(scores[~near].max(initial=0))


def rated(looker: Looker, parts: Sequence[tuple[str, Labelled]]) -> dict[str, list[Any]]:
    """Return, by state, the best score at the ball and the best elsewhere in each window."""
    found: dict[str, list[Any]] = {}
    for state, part in parts:
        small = looker.shrink(part).picture
        gain = small.shape[1] / part.picture.shape[1]
        scores = best_scores(looker.look(small), part.boxes[0], gain)
        found.setdefault(state, []).append(scores)
    return found


def rated_best(scores: Sequence[tuple[float, float]]) -> float:
    """Return the share of windows in which the ball's score is above the best elsewhere."""
    true, false = np.array(scores).T
    return round(float((true > false).mean()), 3)


def row_of(
    version: str, state: str, scores: Sequence[tuple[float, float]],
    turned: Sequence[tuple[float, float]],
) -> dict[str, Any]:  # fmt: skip
    """Return the figures of a detector over the windows of one state, and those mirrored."""
    true, false = np.array(scores).T
    both, which = np.concatenate([true, false]), np.arange(2 * len(true)) < len(true)
    return {
        "detector": version, "ball": state, "windows": len(true),
        "rated best": rated_best(scores), "mirrored": rated_best(turned),
        "pairs": round(area(both, which), 3),
    }  # fmt: skip


@click.command(cls=Bench)
@click.argument("versions", nargs=-1, required=True, metavar="NAME=FILE[@WIDTHxHEIGHT]...")
@click.option("--sequence", type=click.Path(path_type=Path, exists=True), help="SoccerNet folder.")
@click.option("--football", type=click.Path(path_type=Path, exists=True), help="Labelled stills.")
@click.option("--every", default=2, show_default=True, type=click.IntRange(1), help="Frames.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Of windows.")
@JSON
def main(
    versions: tuple[str, ...], sequence: Path | None, football: Path | None, every: int, seed: int,
    path: Path | None,
) -> None:  # fmt: skip
    """Say how often the ball is rated best of what a ROI shows."""
    if not (sequence or football):
        raise SettingsError("expected --sequence or --football, got neither")
    parts = list(of_sequence(sequence, every, seed)) if sequence else []
    parts += of_stills(football, seed) if football else []
    if not parts:
        raise SettingsError("expected balls in what was given, got none")
    turned = [(state, mirrored(part)) for state, part in parts]
    rows = []
    for version in versions:
        name, file, input_px = named(version)
        usual = Looker(file, {}, 1.0, 1, FLOOR, input_px)
        looker = Looker(file, {}, usual.input_px[0] / WINDOW_PX[0], 1, FLOOR, input_px)
        looker.known(BALL)
        as_seen, exchanged = rated(looker, parts), rated(looker, turned)
        rows += [row_of(name, s, as_seen[s], exchanged[s]) for s in sorted(as_seen)]
    Console().print(table("the ball rated best of what a ROI shows", rows))
    if path:
        told = [str(folder.name) for folder in (sequence, football) if folder]
        report = {"bench": "roi_balls", "data": ", ".join(told), "seed": seed, "rows": rows}
        write_whole(path, json.dumps(facts() | report, indent=1) + "\n")


if __name__ == "__main__":
    main()
