"""Fit and score how kits tell referees: `python -m bench.kits NAME=FILE … --football FOLDER`.

`--fit` fits the weights of `operators.kits` and prints them: those of kits on the stills that the
detector was trained on, where its word would count too much, and how both are weighed on the
development stills and on drawn clips for development, whose goalkeepers wear rare kits, too, with
the constant at which referees have the precision of `--precision` there. Scores players and
referees as the detector reports them, and with kits, on these, on stills and drawn clips left out,
and on SEQUENCE, a SoccerNet folder; pictures are shrunk to the context's size.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from bench.ball_candidates import labelled
from bench.detector import TRAINING
from bench.detector_scoring import Looker
from bench.detector_versions import named
from bench.logistic import regressed
from bench.machine import facts
from bench.options import JSON, Bench
from bench.people_missed import PEOPLE, assigned, of_sequence, of_stills
from bench.prototype import table
from drivers.scenes.soccer import SoccerScene
from operators import kits
from operators.saliency.example import NAMES
from operators.training.stills import Labelled
from pipeline.colours import colours
from pipeline.errors import RunError
from pipeline.whole_file import write_whole

# seeds of drawn clips; nothing is chosen on those left out
DRAWN = {"drawn, development": range(50_000, 50_008), "drawn, left out": range(71_000, 71_012)}
DRAWN_FRAMES = range(0, 150, 15)
CONFIDENCE = 0.3  # of the detector, for players and referees
PENALTY = 0.5  # on the squares of the weights, of inputs of the same width
Array = NDArray[np.float32]
Floats = NDArray[np.float64]
Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """The people that were found in a picture, best first, and those that are there."""

    boxes: Array  # (n, 4)
    scores: Array  # (n,)
    said: Floats  # (n, 2) as `kits.people` tells
    worn: Floats  # (n, 2, 3) as `colours` tells
    reported: Mapping[str, tuple[Array, Array]]  # what the detector reports by class
    truth: Mapping[str, Array]  # boxes by class


def scene(small: Labelled, found: Mapping[str, tuple[Array, Array]]) -> Scene:
    """Return what matters of a picture, shrunk, and what was found in it."""
    boxes = np.concatenate([found[name][0] for name in PEOPLE])
    scores = np.concatenate([found[name][1] for name in PEOPLE])
    labels = np.repeat(np.arange(len(PEOPLE)), [len(found[name][1]) for name in PEOPLE])
    rows, said = kits.people(boxes, scores, labels, 0, 1)
    return Scene(
        boxes=boxes[rows],
        scores=scores[rows],
        said=said,
        worn=np.nan_to_num(colours(small.picture, boxes[rows])),
        reported={name: found[name] for name in PEOPLE},
        truth={name: small.boxes[small.numbers == NAMES.index(name)] for name in PEOPLE},
    )


def of_drawn(looker: Looker, seeds: Iterable[int]) -> Iterator[Scene]:
    """Yield pictures of drawn clips."""
    for seed in track(list(seeds), "drawn", console=Console(stderr=True)):
        source = SoccerScene(size_px=(1920, 1080), rate_hz=30, seed=seed)
        for index in DRAWN_FRAMES:
            small = looker.shrink(labelled(source, index, source.truth(index)))
            yield scene(small, looker.look(small.picture))


def truly_referees(of: Scene) -> NDArray[np.bool_]:
    """Return which of the people found are referees: (n,)."""
    everybody = np.concatenate([of.truth[name] for name in PEOPLE])
    right, _ = assigned(of.boxes, of.scores, everybody)
    mine, _ = assigned(of.boxes, of.scores, of.truth[kits.REFEREE])
    return np.asarray(right & mine, np.bool_)


def scaled(inputs: Floats, outcome: NDArray[np.bool_]) -> Floats:
    """Return weights of inputs (n, k) of unlike widths and a constant: (k + 1,)."""
    middle, width = inputs.mean(0), inputs.std(0) + 1e-6
    weights = regressed((inputs - middle) / width, outcome, PENALTY)
    own = weights[:-1] / width
    return np.append(own, weights[-1] - own @ middle)


def fitted(
    trained_on: Sequence[Scene], development: Sequence[Scene], precision: float
) -> tuple[Floats, Floats]:
    """Return the weights of kits, and those of all evidence."""
    outcome = np.concatenate([truly_referees(of) for of in trained_on])
    of_kits = scaled(np.concatenate([kits.signs(of.worn) for of in trained_on]), outcome)
    known = np.concatenate([kits.evidence(of.said, of.worn, of_kits) for of in development])
    weights = scaled(known, np.concatenate([truly_referees(of) for of in development]))
    odds = [kits.evidence(of.said, of.worn, of_kits) @ weights[:-1] for of in development]
    for least in sorted(np.concatenate(odds)):
        weights[-1] = -least
        if judged(development, of_kits, weights)[kits.REFEREE]["precision"] >= precision:
            return of_kits, weights
    raise RunError(f"precision: expected one that referees reach, got {precision:g}")


def judged(scenes: Iterable[Scene], of_kits: Floats, weights: Floats) -> dict[str, Row]:
    """Return precision and recall of players and referees, with kits."""
    found: list[dict[str, tuple[Array, Array]]] = []
    kept = list(scenes)
    for of in kept:
        odds = kits.evidence(of.said, of.worn, of_kits) @ weights[:-1] + weights[-1]
        few = len(odds) < kits.KitsSettings().least_people
        is_referee = odds >= 0
        classes = {kits.REFEREE: is_referee, kits.PLAYER: ~is_referee}
        own = {name: (of.boxes[mine], of.scores[mine]) for name, mine in classes.items()}
        found.append(dict(of.reported) if few else own)
    return scored(kept, found)


def scored(
    scenes: Sequence[Scene], found: Sequence[Mapping[str, tuple[Array, Array]]]
) -> dict[str, Row]:
    """Return precision and recall of what was found in scenes, by class."""
    rows = {}
    for name in PEOPLE:
        marks = [
            assigned(*own[name], of.truth[name]) for own, of in zip(found, scenes, strict=True)
        ]
        hits, told = sum(int(r.sum()) for r, _ in marks), sum(len(r) for r, _ in marks)
        present = sum(len(best) for _, best in marks)
        rows[name] = {
            "present": present, "precision": round(hits / max(1, told), 3),
            "recall": round(hits / max(1, present), 3),
        }  # fmt: skip
    return rows


def rows_of(
    version: str, data: Mapping[str, Sequence[Scene]], of_kits: Floats, weights: Floats
) -> Iterator[Row]:
    """Yield precision and recall without and with kits."""
    for name, scenes in data.items():
        ways = {
            "detector alone": scored(scenes, [of.reported for of in scenes]),
            "with kits": judged(scenes, of_kits, weights),
        }
        for way, classes in ways.items():
            for label, row in classes.items():
                yield {"version": version, "data": name, "class": label, "by": way, **row}


@click.command(cls=Bench)
@click.argument("versions", nargs=-1, required=True)
@click.option("--football", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--sequence", type=click.Path(path_type=Path, exists=True), help="SoccerNet's.")
@click.option("--fit", is_flag=True, help="Fit the weights first, on the first version.")
@click.option("--precision", default=0.85, show_default=True, type=click.FloatRange(0, 1))
@JSON
def main(
    versions: Sequence[str], football: Path, sequence: Path | None, fit: bool, precision: float,
    path: Path | None,
) -> None:  # fmt: skip
    """Fit or score how kits tell referees."""
    of_kits, weights = kits.KIT_WEIGHTS, kits.WEIGHTS
    rows: list[Row] = []
    for number, (version, file, input_px) in enumerate(map(named, versions)):
        looker = Looker(file, {}, 0.25, 1, confidence=CONFIDENCE, input_px=input_px)
        for name in PEOPLE:
            looker.known(name)

        def of_split(split: str, looker: Looker = looker) -> list[Scene]:
            return [scene(*pair) for pair in of_stills(football, looker, split)]

        development = of_split("development")
        drawn = {name: list(of_drawn(looker, seeds)) for name, seeds in DRAWN.items()}
        if fit and not number:
            both = [*development, *drawn["drawn, development"]]
            of_kits, weights = fitted(of_split(TRAINING), both, precision)
            for name, values in {"KIT_WEIGHTS": of_kits, "WEIGHTS": weights}.items():
                told = ", ".join(f"{value:.4g}" for value in values)
                click.echo(f"{name} = np.array([{told}])")
        data = {"development": development, "left out": of_split("test"), **drawn}
        if sequence:
            data[sequence.name] = [scene(*pair) for pair in of_sequence(sequence, looker, 1)]
        rows += rows_of(version, data, of_kits, weights)
    Console().print(table("players and referees", rows))
    if path:
        report = facts() | {
            "bench": "kits", "confidence": CONFIDENCE, "scale": 0.25, "fitted": fit,
            "precision_chosen": precision, "kit_weights": [float(f"{w:.4g}") for w in of_kits],
            "weights": [float(f"{w:.4g}") for w in weights], "rows": rows,
        }  # fmt: skip
        write_whole(path, json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
