"""Is the ball among a detector's best candidates? `python -m bench.ball_candidates SEQUENCE`.

SEQUENCE is a SoccerNet folder. Every picture is shrunk to the context's size; a frame counts where
the truth has a ball of which enough is visible, apart for a ball that lies still, is free or is
carried (bench/tracking/targets.py). A candidate is right if its centre is within six pixels of the
context. Also prints players, referees and the ball at the detector's own confidence.
"""

import json
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from bench.detector_scoring import BEST, Looker, Marks, among_best, figures
from bench.machine import facts
from bench.options import JSON, Bench, file_name
from bench.tracking.targets import targets
from drivers.datasets.soccernet import SoccerNetSequence
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE, Annotations, FrameSource
from operators.saliency.difference import FrameDifference
from operators.saliency.example import BALL, NAMES
from operators.saliency.judging import FLOOR
from operators.training.stills import Labelled
from pipeline.errors import DriverError
from pipeline.whole_file import write_whole

WANTED = dict(enumerate(NAMES))


@click.command(cls=Bench)
@click.argument("sequence", type=click.Path(path_type=Path))
@click.option("--weights", default="", help="As saliency.weights; the shipped detector's if none.")
@click.option("--scale", default=0.25, show_default=True, type=click.FloatRange(0.01, 1))
@click.option("--every", default=1, show_default=True, type=click.IntRange(1), help="Frames.")
@click.option("--threads", default=1, show_default=True, type=click.IntRange(1))
@JSON
def main(
    sequence: Path, weights: str, scale: float, every: int, threads: int, path: Path | None
) -> None:
    """Say how often the ball is among a detector's best candidates."""
    report = facts() | candidates(sequence, weights, scale=scale, every=every, threads=threads)
    if path:
        write_whole(path, json.dumps(report, indent=1) + "\n")
    for table in shown(report):
        Console().print(table)


def candidates(
    sequence: Path, weights: str, *, scale: float, every: int = 1, threads: int = 1,
    input_px: tuple[int, int] = (0, 0),
) -> dict[str, Any]:  # fmt: skip
    """Return the report on a detector and a sequence; raises `DriverError`, `WeightsError`."""
    looker = Looker(weights, {}, scale, threads, confidence=FLOOR, input_px=input_px)
    for name in NAMES:
        looker.known(name)
    source = SoccerNetSequence(path=str(sequence))
    truths = truths_of(source)
    balls = targets(truths, [BALL], players=1, seed=0, width_px=source.size_px[0])
    if not balls:
        raise DriverError(
            f"{sequence}: expected a ball in at least a tenth of the frames, got none"
        )
    ball = balls[0]
    marks, among = Marks(), defaultdict[str, list[bool]](list)
    frames = range(0, len(truths), every)
    for k in track(frames, "score", console=Console(stderr=True)):
        small = looker.shrink(labelled(source, k, truths[k]))
        found = looker.look(small.picture, changed(looker, source, k, small))
        marks.take(found, small, WANTED)
        true = small.boxes[small.numbers == NAMES.index(BALL)]
        if ball.visible[k] >= LEAST_VISIBLE and len(true):
            among[ball.state[k]].append(among_best(found[BALL], true))
    source.close()
    own = {name: looker.confidence_of(name) for name in marks.tallies}
    return {
        "bench": "ball_candidates", "weights": file_name(looker.path), "data": sequence.name,
        "frames": len(frames), "scale": scale, "best": BEST,
        "among": {state: _share(rows) for state, rows in sorted(among.items())},
        "classes": figures(marks, own),
    }  # fmt: skip


def changed(
    looker: Looker, source: SoccerNetSequence, index: int, small: Labelled
) -> NDArray[np.int16] | None:
    """What changed in a frame since the one before, for a detector that reads it."""
    if not looker.reads_difference or not index:
        return None
    size_px = small.picture.shape[1], small.picture.shape[0]
    before = cv2.resize(source.picture(index - 1), size_px, interpolation=cv2.INTER_AREA)
    difference = FrameDifference()
    difference.of(np.asarray(before, np.uint8))
    return difference.of(small.picture)


def labelled(source: FrameSource, index: int, truth: Annotations) -> Labelled:
    """A frame with those objects of the detector's classes of which enough is visible."""
    kept = [
        row
        for row, label in enumerate(truth.labels)
        if label in CLASS_OF_ROLE and truth.visibility[row] >= LEAST_VISIBLE
    ]
    numbers = [NAMES.index(CLASS_OF_ROLE[truth.labels[row]]) for row in kept]
    return Labelled(
        picture=source.picture(index), boxes=truth.boxes[kept], numbers=np.array(numbers, np.int64)
    )


def truths_of(source: SoccerNetSequence) -> list[Annotations]:
    """Return the truth of the frames of a sequence; empty where it knows none."""
    found = [source.truth(k) for k in range(source.length or 0)]
    return [truth for truth in found if truth is not None]


def _share(rows: Iterable[bool]) -> dict[str, float]:
    kept = list(rows)
    return {"frames": len(kept), "share": round(sum(kept) / max(1, len(kept)), 3)}


def shown(report: dict[str, Any]) -> list[Table]:
    """Return the figures for a terminal."""
    title = f"{report['weights']} on {report['data']} at {report['scale']:g}"
    states = Table("ball", "frames", f"among the best {BEST}", title=title)
    for state, row in report["among"].items():
        states.add_row(state, str(row["frames"]), f"{row['share']:.3f}")
    names = ("class", "present", "confidence", "precision", "recall", "average_precision")
    classes = Table(*(name.replace("_", " ") for name in names))
    for row in report["classes"]:
        classes.add_row(*(str(row[name]) for name in names))
    return [states, classes]


if __name__ == "__main__":
    main()
