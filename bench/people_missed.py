"""Why people are missed: `python -m bench.people_missed NAME=FILE[@WxH] … --sequence FOLDER`.

Scores versions of the detector on a SoccerNet folder and on the stills of FOOTBALL that no training
saw, shrunk to the context's size. Recall is that at the least confidence with the precision of
`--precision` over these same pictures: no confidence that could have been chosen before does
better. It stands by how much of a person is behind, or before, the box of another, and beside the
recall at any confidence, and the share that was found as anybody, player or referee.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from bench.ball_candidates import changed, labelled, truths_of
from bench.detector import KNOWN, of_split
from bench.detector_scoring import Found, Looker
from bench.detector_versions import named
from bench.machine import facts
from bench.options import JSON, Bench
from bench.prototype import table
from drivers.datasets.soccernet import SoccerNetSequence
from operators.saliency.example import NAMES
from operators.saliency.judging import FLOOR, LEAST_IOU, matched
from operators.training.stills import Labelled, class_names
from operators.training.stills import labelled as read_labelled
from pipeline.boxes import areas, intersections, iou
from pipeline.errors import DriverError, SettingsError
from pipeline.whole_file import write_whole

PEOPLE = ("player", "referee")
COVERED = (0.0, 0.15, 0.4, 1.01)  # bounds of the shares of a box that another person's covers
ALL = "all"
Array = NDArray[np.float32]
Row = dict[str, Any]


@dataclass(kw_only=True)
class Sightings:
    """What a version found of the people of one class in some pictures."""

    scores: list[Array] = field(default_factory=list)  # of each detection
    right: list[NDArray[np.bool_]] = field(default_factory=list)  # of each detection
    best: list[Array] = field(default_factory=list)  # of each person: of what found it, or 0
    anybody: list[Array] = field(default_factory=list)  # the same of either class
    covered: list[Array] = field(default_factory=list)  # of each person: share behind another

    def add(self, found: Found, own: str, people: Array, mine: NDArray[np.bool_]) -> None:
        """Take what was found in a picture with `people` (n, 4), of which `mine` (n,) are of it."""
        boxes, scores = found[own]
        right, best = assigned(boxes, scores, people[mine])
        every = np.concatenate([found[name][0] for name in PEOPLE])
        of_every = np.concatenate([found[name][1] for name in PEOPLE])
        order = np.argsort(-of_every, kind="stable")
        self.scores.append(scores)
        self.right.append(right)
        self.best.append(best)
        self.anybody.append(assigned(every[order], of_every[order], people)[1][mine])
        self.covered.append(covered(people)[mine])

    def rows(self, precision: float) -> Iterator[Row]:
        """Yield the figures of all people of the class, then by how much of them is covered."""
        best, anybody = np.concatenate(self.best), np.concatenate(self.anybody)
        share = np.concatenate(self.covered)
        least = least_confidence(np.concatenate(self.scores), np.concatenate(self.right), precision)
        parts = {ALL: np.ones(len(share), np.bool_)} | {
            f"{low:g} to {min(1.0, high):g}": (share >= low) & (share < high)
            for low, high in pairwise(COVERED)
        }
        for name, mine in parts.items():
            if mine.any():
                yield {
                    "covered": name, "present": int(mine.sum()),
                    "confidence": None if least is None else round(least, 3),
                    "recall": None if least is None else told(best[mine] >= least),
                    "recall at any": told(best[mine] > 0), "as anybody": told(anybody[mine] > 0),
                }  # fmt: skip


def told(found: NDArray[np.bool_]) -> float:
    """Return a share of people."""
    return round(float(found.mean()), 3)


def covered(people: Array) -> Array:
    """Return the share of each box that is inside one other: (n,), 0..1.

    >>> covered(np.array([[0, 0, 4, 4], [2, 0, 6, 4], [9, 9, 10, 10]], np.float32)).tolist()
    [0.5, 0.5, 0.0]
    """
    shared = intersections(people, people)
    np.fill_diagonal(shared, 0)
    most = shared.max(1) if len(people) else np.zeros(0, np.float32)
    return np.asarray(most / np.maximum(areas(people), 1e-9), np.float32)


def assigned(boxes: Array, scores: Array, truth: Array) -> tuple[NDArray[np.bool_], Array]:
    """Whether each detection (n,), best first, is the first of a person; the score of each (m,)."""
    overlap = iou(boxes, truth)
    hit = matched(np.where(overlap >= LEAST_IOU, overlap, 0), np.ones(len(truth), np.bool_))
    right, best = hit >= 0, np.zeros(len(truth), np.float32)
    best[hit[right]] = scores[right]
    return right, best


def least_confidence(scores: Array, right: NDArray[np.bool_], precision: float) -> float | None:
    """Return the least confidence from which on so many are right; None if there is none."""
    order = np.argsort(-scores, kind="stable")
    share = right[order].cumsum() / np.arange(1, len(order) + 1)
    fit = np.flatnonzero(share >= precision)
    return float(scores[order][fit[-1]]) if len(fit) else None


def frames_of(folder: Path, every: int) -> Iterator[tuple[SoccerNetSequence, int, Labelled]]:
    """Yield the source of a SoccerNet folder, and indices and pictures of its frames."""
    source = SoccerNetSequence(path=str(folder))
    try:
        truths = truths_of(source)
        if not truths:
            raise DriverError(f"{folder}: expected a sequence with its truth, got none")
        for k in track(range(0, len(truths), every), folder.name, console=Console(stderr=True)):
            yield source, k, labelled(source, k, truths[k])
    finally:
        source.close()


def of_sequence(folder: Path, looker: Looker, every: int) -> Iterator[tuple[Labelled, Found]]:
    """Yield the frames of a SoccerNet folder, shrunk, and what was found in them."""
    for source, k, whole in frames_of(folder, every):
        small = looker.shrink(whole)
        yield small, looker.look(small.picture, changed(looker, source, k, small))


def stills_of(folder: Path, split: str, only: Sequence[str] = ("",)) -> Iterator[Labelled]:
    """Yield the stills of a split, with the numbers of `NAMES`.

    `only`: those whose names begin with one of these. Raises `SettingsError` where there is none.
    """
    known = class_names(folder / "data.yaml")
    own = {k: KNOWN.get(name, name) for k, name in known.items()}
    if other := sorted(set(own.values()) - set(NAMES)):
        raise SettingsError(f"{folder}: expected classes {', '.join(NAMES)}, got {other[0][:40]}")
    number = {k: NAMES.index(name) for k, name in own.items()}
    files = [file for file in of_split(folder, split) if file.name.startswith(tuple(only))]
    if not files:
        some = ", ".join(only)
        raise SettingsError(f"{folder}: expected {split} stills named {some}…, got none")
    for file in track(files, folder.name, console=Console(stderr=True)):
        still = read_labelled(file)
        if unknown := {int(k) for k in still.numbers} - number.keys():
            raise DriverError(f"{file}: expected a class of data.yaml, got {min(unknown)}")
        numbers = np.array([number[int(k)] for k in still.numbers], np.int64)
        yield Labelled(picture=still.picture, boxes=still.boxes, numbers=numbers)


def of_stills(folder: Path, looker: Looker, split: str) -> Iterator[tuple[Labelled, Found]]:
    """Yield the stills of a split, shrunk, and what was found in them."""
    for still in stills_of(folder, split):
        small = looker.shrink(still)
        yield small, looker.look(small.picture)


def rows_of(
    pictures: Iterator[tuple[Labelled, Found]], precisions: Mapping[str, float]
) -> Iterator[Row]:
    """Yield the figures of players and referees in some pictures."""
    by_class = {name: Sightings() for name in PEOPLE}
    for small, found in pictures:
        people = np.isin(small.numbers, [NAMES.index(name) for name in PEOPLE])
        for name, of in by_class.items():
            mine = small.numbers[people] == NAMES.index(name)
            of.add(found, name, small.boxes[people], mine)
    for name, of in by_class.items():
        for row in of.rows(precisions[name]):
            yield {"class": name, "precision": precisions[name], **row}


@click.command(cls=Bench)
@click.argument("versions", nargs=-1, required=True)
@click.option("--sequence", type=click.Path(path_type=Path, exists=True), help="SoccerNet's.")
@click.option("--football", type=click.Path(path_type=Path, exists=True), help="Labelled stills.")
@click.option("--scale", default=0.25, show_default=True, type=click.FloatRange(0.01, 1))
@click.option("--every", default=1, show_default=True, type=click.IntRange(1), help="Frames.")
@click.option(
    "--precision", "precisions", nargs=2, default=(0.9, 0.85), show_default=True,
    type=click.FloatRange(0, 1), help="Of players and of referees.",
)  # fmt: skip
@JSON
def main(
    versions: Sequence[str], sequence: Path | None, football: Path | None, scale: float,
    every: int, precisions: tuple[float, float], path: Path | None,
) -> None:  # fmt: skip
    """Say which people are missed."""
    if sequence is None and football is None:
        raise SettingsError("data: expected --sequence or --football, got none of them")
    wanted = dict(zip(PEOPLE, precisions, strict=True))
    rows: list[Row] = []
    for version, file, input_px in map(named, versions):
        looker = Looker(file, {}, scale, 1, confidence=FLOOR, input_px=input_px)
        for name in PEOPLE:
            looker.known(name)
        data = {}
        if sequence:
            data[sequence.name] = of_sequence(sequence, looker, every)
        if football:
            data[football.name] = of_stills(football, looker, "test")
        for name, pictures in data.items():
            rows += ({"version": version, "data": name} | r for r in rows_of(pictures, wanted))
    Console().print(table("people, found and missed", rows))
    if path:
        report = facts() | {
            "bench": "people_missed", "scale": scale, "every": every, "least_iou": LEAST_IOU,
            "rows": rows,
        }  # fmt: skip
        write_whole(path, json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
