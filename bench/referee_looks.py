"""How a look at full resolution tells referees: `python -m bench.referee_looks NAME=FILE[@WxH] …`.

In the stills of FOOTBALL the detector of the context finds people down to a score of .03. Full
resolution around each is read by `closer` and encoder of `graphs/tracking.yaml`; where `closer`
finds somebody there, its box counts, or, to compare, that of the context. Logistic regressions over
the development match weigh what each says, and choose the confidence at which referees have the
precision of `--precision` there.
`--fold MATCH,…=CONTEXT,CLOSER` names matches of the training, and two detectors that were not
trained on them. Their stills are looked at by these two; weights and confidence are then fitted to
them and the development match together as well, and each match is told by the others.
For the matches left out, and for SEQUENCE, a SoccerNet folder, the table has precision and recall
at that confidence, and recall at the least one that has this precision on these very pictures.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.special import logit

from bench.detector import TRAINING, of_split
from bench.detector_scoring import Looker
from bench.detector_versions import named
from bench.kits import scaled
from bench.machine import facts
from bench.options import JSON, Bench
from bench.people_missed import PEOPLE, assigned, frames_of, least_confidence, stills_of, told
from bench.prototype import table
from bench.second_look import SCALE, Looks, window_around
from operators import kits
from operators.saliency.example import NAMES
from operators.training.stills import Labelled
from pipeline.boxes import iou
from pipeline.colours import colours
from pipeline.errors import SettingsError
from pipeline.whole_file import write_whole

FAINTEST = 0.03  # score in the context of somebody who is looked at
SURE = 0.3  # score of those among whom kits are compared
LEAST = 0.02  # score of people in the ROI; shares are clipped to LEAST .. 1 - LEAST
SAME_PLACE = 0.15  # IoU of somebody's boxes in the context and in the ROI
# columns of what is known of somebody
COLUMNS = "referee", "player", "kits", "referee in ROI", "player in ROI", "encoder"
CONTEXT, KITS, ROI, ENCODER = (0, 1), (2,), (3, 4), (5,)
WAYS = {  # columns, and whether the ROI's box counts
    "the context": (CONTEXT, False), "the context and kits": ((*CONTEXT, *KITS), False),
    "the ROI": (ROI, True), "the ROI, boxes of the context": (ROI, False),
    "the ROI and encoder": ((*ROI, *ENCODER), True),
    "the context and the ROI": ((*CONTEXT, *ROI), True),
    "the ROI and kits": ((*ROI, *KITS), True),
    "the ROI and kits, boxes of the context": ((*ROI, *KITS), False),
    "the ROI, encoder and kits": ((*ROI, *ENCODER, *KITS), True),
}  # fmt: skip
# the encoder was trained on the matches of folds
WITHOUT_ENCODER = [way for way, (columns, _) in WAYS.items() if not {*ENCODER} & {*columns}]
ALL, EACH = "development and folds", "each match by the others"
FOLD_PX = (736, 416)  # input of a fold's detector of the context
Array = NDArray[np.float32]
Floats = NDArray[np.float64]
# odds of all found (n,), whether each is a referee (n,), and how many referees there are
Marks = tuple[Array, NDArray[np.bool_], int]
Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class People:
    """Those who were found in the context of a picture, the surest first, and what is known."""

    boxes: Array  # (n, 4) in the context, pixels of the sensor
    shown: Array  # (n, 4) in the ROI, or in the context where it shows nobody
    worn: Floats  # (n, 2, 3) in the context, as `colours` tells
    known: Floats  # (n, 6) logarithms of odds; columns as above
    referees: Array  # (m, 4) that are there

    def by(self, columns: Sequence[int], *, in_roi: bool) -> tuple[Array, Floats]:
        """Return boxes (k, 4), of the ROI or the context, and columns of what is known (k, ...).

        Two boxes of one person count once.
        """
        boxes = self.shown if in_roi else self.boxes
        falling = np.linspace(1, 0.5, len(boxes), dtype=np.float32)
        rows, _ = kits.people(boxes, falling, np.zeros(len(boxes), np.int64), 0, 1)
        return boxes[rows], self.known[rows][:, list(columns)]


class PeopleLooks:
    """A detector of the context, and what `graphs/tracking.yaml` has for a ROI.

    `closer`: weights of the detector there, where they are others.
    """

    def __init__(self, file: str, input_px: tuple[int, int], closer: str = "") -> None:
        self._context = Looker(file, {}, 1 / SCALE, 1, confidence=FAINTEST, input_px=input_px)
        self._looks = Looks(dict.fromkeys(PEOPLE, LEAST), closer)

    def people(self, whole: Labelled) -> People:
        """Return who is found in a picture of the sensor, and what a look at each tells."""
        small = self._context.shrink(whole)
        found = self._context.look(small.picture)
        boxes = np.concatenate([found[name][0] for name in PEOPLE])
        scores = np.concatenate([found[name][1] for name in PEOPLE])
        labels = np.repeat(np.arange(len(PEOPLE)), [len(found[name][1]) for name in PEOPLE])
        rows, said = kits.people(boxes, scores, labels, 0, 1)
        worn = np.nan_to_num(colours(small.picture, boxes[rows]))
        height, width = whole.picture.shape[:2]
        small_height, small_width = small.picture.shape[:2]
        gain = np.array([width / small_width, height / small_height] * 2, np.float32)
        at = boxes[rows] * gain
        shown, looked = at.copy(), np.zeros((len(at), 3))
        for k, box in enumerate(at):
            shown[k], looked[k] = self.look(whole.picture, box)
        return People(
            boxes=at,
            shown=shown,
            worn=worn,
            known=np.column_stack([said, by_kits(said, worn, scores[rows] >= SURE), looked]),
            referees=whole.boxes[whole.numbers == NAMES.index(kits.REFEREE)],
        )

    def look(self, picture: NDArray[np.uint8], box: Array) -> tuple[Array, Floats]:
        """Return somebody's box in the ROI (4,), and the columns of ROI and encoder (3,)."""
        frame = window_around(picture, box)
        shares = np.array([0, 0, self._looks.genuine(frame, box, kits.REFEREE)])
        found = [
            (float(iou(one[None], box[None])[0, 0]), float(score), name, one)
            for name, (boxes, scores) in zip(PEOPLE, self._looks.finds(frame, PEOPLE), strict=True)
            for one, score in zip(boxes, scores, strict=True)
        ]
        overlap, score, name, one = max(found, key=itemgetter(0), default=(0.0, 0.0, "", box))
        if overlap >= SAME_PLACE:
            box, shares[0 if name == kits.REFEREE else 1] = one, score
        return box, np.asarray(logit(np.clip(shares, LEAST, 1 - LEAST)))


def by_kits(said: Floats, worn: Floats, sure: NDArray[np.bool_]) -> Floats:
    """Return the odds that each is a referee as `operators.kits` has them (n,), their logarithm.

    They count what the detector says as well. Kits are those of whom it is sure, and each of the
    others beside them; beside too few they count nothing.
    """
    known = np.flatnonzero(sure)

    def odds(rows: NDArray[np.intp]) -> Floats:
        told = kits.evidence(said[rows], worn[rows])
        return np.asarray(told @ kits.WEIGHTS[:-1] + kits.WEIGHTS[-1])

    found: Floats = said @ kits.WEIGHTS[:2] + kits.WEIGHTS[-1]
    if len(known) < kits.KitsSettings().least_people:
        return found
    found[known] = odds(known)
    for k in np.flatnonzero(~sure):
        found[k] = odds(np.append(known, k))[-1]
    return found


def marks(
    people: Iterable[People], columns: Sequence[int], weights: Floats, *, in_roi: bool
) -> Marks:
    """Return the marks of all who are found, by the weights of what is known of them."""
    odds, right, present = [], [], 0
    for of in people:
        boxes, known = of.by(columns, in_roi=in_roi)
        own = (known @ weights[:-1] + weights[-1]).astype(np.float32)
        order = np.argsort(-own, kind="stable")
        odds.append(own[order])
        right.append(assigned(boxes[order], own[order], of.referees)[0])
        present += len(of.referees)
    return np.concatenate(odds), np.concatenate(right), present


def fitted(people: Sequence[People], columns: Sequence[int], *, in_roi: bool) -> Floats:
    """Return a weight for each of the columns and a constant: (columns + 1,)."""
    known = [of.by(columns, in_roi=in_roi) for of in people]
    right = [
        assigned(boxes, np.ones(len(boxes), np.float32), of.referees)[0]
        for of, (boxes, _) in zip(people, known, strict=True)
    ]
    return scaled(np.concatenate([own for _, own in known]), np.concatenate(right))


def rows_of(
    version: str, data: Mapping[str, Sequence[People]], precision: float,
    ways: Iterable[str] = tuple(WAYS),
) -> Iterator[Row]:  # fmt: skip
    """Yield the figures of referees by each way, fitted to the first of the data."""
    known, development = next(iter(data.items()))
    for way in ways:
        columns, in_roi = WAYS[way]
        weights = fitted(development, columns, in_roi=in_roi)
        odds, right, _ = marks(development, columns, weights, in_roi=in_roi)
        chosen = least_confidence(odds, right, precision)
        told_by = [*(COLUMNS[column] for column in columns), "constant"]
        gains = ", ".join(f"{n} {w:.3g}" for n, w in zip(told_by, weights, strict=True))
        for name, people in data.items():
            found = marks(people, columns, weights, in_roi=in_roi)
            row = {"version": version, "data": name, "told by": way, "fitted to": known}
            yield row | {"gains": gains} | figures(found, chosen, precision)


def by_others(
    version: str, matches: Sequence[Sequence[People]], precision: float, ways: Iterable[str]
) -> Iterator[Row]:
    """Yield the figures of referees of all matches, each by weights fitted to the others."""
    for way in ways:
        columns, in_roi = WAYS[way]
        found = [own for own, _ in each_by_others(matches, columns, in_roi=in_roi)]
        odds, right, present = zip(*found, strict=True)
        both = np.concatenate(odds), np.concatenate(right), sum(present)
        row = {"version": version, "data": EACH, "told by": way, "fitted to": "the others"}
        unchosen = {"gains": "", "precision": None, "recall": None}
        yield row | figures(both, None, precision) | unchosen


def each_by_others(
    matches: Sequence[Sequence[People]], columns: Sequence[int], *, in_roi: bool
) -> Iterator[tuple[Marks, Marks]]:
    """Yield the marks of each match, and of all others, by weights fitted to the others."""
    for own, match in enumerate(matches):
        others = [of for k, rest in enumerate(matches) if k != own for of in rest]
        weights = fitted(others, columns, in_roi=in_roi)
        first, second = (marks(of, columns, weights, in_roi=in_roi) for of in (match, others))
        yield first, second


def figures(found: Marks, chosen: float | None, precision: float) -> Row:
    """Return the figures of those found, at a confidence and at the least one of a precision."""
    odds, right, present = found
    own = least_confidence(odds, right, precision)
    kept = odds >= (np.inf if chosen is None else chosen)
    at_best = odds >= (np.inf if own is None else own)
    return {
        "present": present, "precision": told(right[kept]) if kept.any() else None,
        "recall": share(right, kept, present),
        f"recall at {precision:g}": share(right, at_best, present),
        "recall at any": share(right, np.ones(len(odds), np.bool_), present),
    }  # fmt: skip


def fold(text: str) -> tuple[tuple[str, ...], str, str]:
    """Return matches, and weights for context and ROI, of a fold; raises `SettingsError`.

    >>> fold("08fd33,538438=a.onnx,b.onnx")
    (('08fd33', '538438'), 'a.onnx', 'b.onnx')
    """
    matches, _, files = text.partition("=")
    names, both = ([part.strip() for part in each.split(",")] for each in (matches, files))
    if not all([*names, *both]) or len(both) != 2:
        raise SettingsError(f"fold: expected MATCH,…=CONTEXT,CLOSER, got {text[:60]!r}")
    return tuple(names), both[0], both[1]


def folds_of(texts: Sequence[str], folder: Path) -> list[tuple[tuple[str, ...], str, str]]:
    """Return all folds as `fold` does; raises `SettingsError` where stills are in none or in two.

    No still may be told by itself.
    """
    folds = [fold(text) for text in texts]
    names = [name for matches, _, _ in folds for name in matches]
    for name in names:
        if sum(other.startswith(name) or name.startswith(other) for other in names) > 1:
            raise SettingsError(f"fold: expected each match once, got {name} again")
        if not any(file.name.startswith(name) for file in of_split(folder, TRAINING)):
            raise SettingsError(f"fold: expected matches of {folder}'s training, got {name}")
    return folds


def share(right: NDArray[np.bool_], kept: NDArray[np.bool_], present: int) -> float:
    """Return the share of those present that are found."""
    return round(float((right & kept).sum() / max(1, present)), 3)


@click.command(cls=Bench)
@click.argument("versions", nargs=-1, required=True)
@click.option("--football", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--sequence", type=click.Path(path_type=Path, exists=True), help="SoccerNet's.")
@click.option(
    "--fold", "folds", multiple=True, metavar="MATCH,…=CONTEXT,CLOSER",
    help="Several times: matches of the training and detectors that did not see them, at 736x416.",
)  # fmt: skip
@click.option("--every", default=5, show_default=True, type=click.IntRange(1), help="Frames.")
@click.option("--precision", default=0.85, show_default=True, type=click.FloatRange(0, 1))
@JSON
def main(
    versions: Sequence[str], football: Path, sequence: Path | None, folds: Sequence[str],
    every: int, precision: float, path: Path | None,
) -> None:  # fmt: skip
    """Say how a look at full resolution tells referees."""
    rows: list[Row] = []
    matches = list[Sequence[People]]()
    parsed = folds_of(folds, football)
    for names, context, closer in parsed:
        looks = PeopleLooks(context, FOLD_PX, closer)
        matches += [
            [looks.people(still) for still in stills_of(football, TRAINING, (name,))]
            for name in names
        ]
    for version, file, input_px in map(named, versions):
        looks = PeopleLooks(file, input_px)
        development = [looks.people(still) for still in stills_of(football, "development")]
        left_out = {"left out": [looks.people(still) for still in stills_of(football, "test")]}
        if sequence:
            frames = frames_of(sequence, every)
            left_out[sequence.name] = [looks.people(frame) for *_, frame in frames]
        rows += rows_of(version, {"development": development} | left_out, precision)
        if matches:
            known = {ALL: [of for match in (development, *matches) for of in match]}
            rows += rows_of(version, known | left_out, precision, WITHOUT_ENCODER)
            rows += by_others(version, [development, *matches], precision, WITHOUT_ENCODER)
    Console().print(table("referees", rows))
    if path:
        report = facts() | {
            "bench": "referee_looks", "scale": 1 / SCALE, "every": every,
            "precision_chosen": precision, "folds": parsed,
            "rows": rows,
        }  # fmt: skip
        write_whole(path, json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
