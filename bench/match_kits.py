"""How kits tell referees within a match: `python -m bench.match_kits NAME=FILE[@WxH] …`.

`operators.kits` compares the kits of one picture, as the context shows them. Here they are those of
a look at full resolution, compared with the other pictures of the match: two teams wear most of
what is seen there, a goalkeeper a kit that few pictures show, referees one that is in most of them,
two or three times each. Below their shorts are knees, below a coach's are none.

First, by kits alone: the people of each match of training and development are judged by weights
that are fitted to the others. Then kits, weighed as on the matches of the training, count beside
what a look tells. No detector was trained on the matches left out, on the one for development and
on SEQUENCE, a SoccerNet folder: each is judged by how both count, and by the confidence at which
referees have the precision of `--aim`, in the others. A new match may have less.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.special import expit, logit

from bench.detector import TRAINING, of_split
from bench.detector_versions import named
from bench.machine import facts
from bench.options import JSON, Bench
from bench.people_missed import frames_of, least_confidence, stills_of, told
from bench.prototype import table
from bench.referee_looks import (
    CONTEXT,
    KITS,
    LEAST,
    ROI,
    SURE,
    Marks,
    People,
    PeopleLooks,
    each_by_others,
    fitted,
    share,
)
from operators.training.stills import Labelled
from pipeline.colours import SHORTS, TORSO, Part, colours, differences
from pipeline.whole_file import write_whole

KNEES: Part = (0.25, 0.64, 0.75, 0.76)
PARTS = (TORSO, SHORTS, KNEES)
# differences in CIELAB at which kits are hardly alike: more than within a picture
SAME_TORSO, SAME_SHORTS = 25.0, 35.0
RARE = 0.05  # people in such a kit in a picture, below which all are as rare
ALIKE = 0.4  # of two kits, above which both are the same
OF_MATCH = (6, 7, 8)  # columns that `with_kits` adds
WAYS = {  # columns of what is known of somebody
    "a look": ROI, "a look and kits of its picture": (*ROI, *KITS),
    "a look and kits of the match": (*ROI, *OF_MATCH),
}  # fmt: skip
LEFT_OUT, ALL = "left out", "all"
Floats = NDArray[np.float64]
Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Looked:
    """The people of a picture, and what they wear at full resolution."""

    people: People
    worn: Floats  # (n, 3, 3): torso, shorts and knees as `colours` tells


def looked(looks: PeopleLooks, picture: Labelled) -> Looked:
    """Look at everybody in a picture."""
    people = looks.people(picture)
    return Looked(people=people, worn=np.nan_to_num(colours(picture.picture, people.shown, PARTS)))


def sure(people: People) -> NDArray[np.bool_]:
    """Return with whose kits others are compared: (n,)."""
    return np.asarray(expit(people.known[:, list(CONTEXT)].max(1)) >= SURE)


def likeness(worn: Floats, others: Floats) -> tuple[Floats, Floats]:
    """Return how alike shirts, and shirts and shorts, of (n, 2, 3) and (m, 2, 3) are: (n, m)."""
    apart = differences(worn[:, None], others[None])
    torso = np.exp(-((apart[..., 0] / SAME_TORSO) ** 2))
    return torso, torso * np.exp(-((apart[..., 1] / SAME_SHORTS) ** 2))


def signs(match: Sequence[People], worn: Sequence[Floats], *, within: bool = False) -> list[Floats]:
    """Return what tells the kits of referees, of worn[k] (n, 2 or more, 3): (n, 5) each.

    How many people of another picture of the match wear such a kit, on average (the logarithm, and
    its square), how many such a shirt (the logarithm), in what share of the pictures somebody is in
    such a kit, and how bright the shorts are. `within`: the other people of the same picture count.
    """
    chosen = [sure(of) for of in match]
    others = np.concatenate([own[rows, :2] for own, rows in zip(worn, chosen, strict=True)])
    picture = np.repeat(np.arange(len(match)), [int(rows.sum()) for rows in chosen])
    count = 1 if within else max(1, len(match) - 1)
    found = []
    for k, (own, rows) in enumerate(zip(worn, chosen, strict=True)):
        rest = (picture == k) == within
        torso, both = likeness(own[:, :2], others[rest])
        if within:  # but their own kits
            torso[rows], both[rows] = (a[rows] - np.eye(len(others[rest])) for a in (torso, both))
        shown = np.zeros((len(match), len(own)))
        np.maximum.at(shown, picture[rest], both.T)
        many, shirts = (np.log(alike.sum(1) / count + RARE) for alike in (both, torso))
        share_of_pictures = (shown > ALIKE).sum(0) / count
        found.append(np.column_stack([many, many**2, shirts, share_of_pictures, own[:, 1, 0] / 50]))
    return found


def knees(worn: Floats) -> Floats:
    """Return how much brighter and of how much another colour knees are than shorts: (n, 2)."""
    apart = worn[:, 2] - worn[:, 1]
    return np.column_stack([apart[:, 0] / 50, np.linalg.norm(apart[:, 1:], axis=1) / 25])


def of_match(match: Sequence[Looked]) -> list[Floats]:
    """Return all signs of the kits of a match, those of the knees last: (n, 7) each."""
    found = signs([of.people for of in match], [of.worn for of in match])
    return [np.column_stack([own, knees(of.worn)]) for own, of in zip(found, match, strict=True)]


def known_by(match: Sequence[Looked], found: Sequence[Floats]) -> list[People]:
    """Return the people of a match, of whom nothing but some signs is known."""
    return [replace(of.people, known=known) for of, known in zip(match, found, strict=True)]


def with_kits(match: Sequence[Looked], weights: Floats) -> list[People]:
    """Return the people of a match, and what their kits tell of them.

    `weights` are those of `of_match`, and a constant. Three columns are added: the evidence against
    a referee, the evidence for one, and whether the ROI shows nobody, where a kit is nobody's. Kits
    tell who is a player more surely than who is a referee, so that each part has its own weight.
    """
    nobody = logit(LEAST) + 0.01
    people = []
    for of, known in zip(match, of_match(match), strict=True):
        evidence = known @ weights[:-1] + weights[-1]
        empty = of.people.known[:, list(ROI)].max(1) < nobody
        own = (np.minimum(evidence, 0), np.maximum(evidence, 0), empty)
        people.append(replace(of.people, known=np.column_stack([of.people.known, *own])))
    return people


def by_kits_alone(matches: Sequence[Sequence[Looked]], precision: float) -> Iterator[Row]:
    """Yield how kits alone tell the referees of each match, by weights fitted to the others."""
    of_context = [[of.people.worn for of in match] for match in matches]
    of_look = [[of.worn for of in match] for match in matches]
    for kit, worn in (("the context", of_context), ("a look", of_look)):
        for beside, within in (("its picture", True), ("the match", False)):
            known = [
                known_by(match, signs([of.people for of in match], own, within=within))
                for match, own in zip(matches, worn, strict=True)
            ]
            yield alone(kit, beside, known, range(5), precision)
    known = [known_by(match, of_match(match)) for match in matches]
    yield alone("a look, with knees", "the match", known, range(7), precision)


def alone(
    kit: str, beside: str, matches: Sequence[Sequence[People]], columns: Sequence[int],
    precision: float,
) -> Row:  # fmt: skip
    """Return the figures of all matches, each judged by the others."""
    found = [own for own, _ in each_by_others(matches, columns, in_roi=True)]
    odds, right, present = (list(each) for each in zip(*found, strict=True))
    every = np.concatenate(odds), np.concatenate(right), sum(present)
    return {
        "kits of": kit, "compared with": beside, "matches": len(found), "present": every[2],
        f"recall at {precision:g}": recall_at(every, precision),
    }  # fmt: skip


def recall_at(found: Marks, precision: float) -> float:
    """Return the recall at the least odds that have a precision on these very pictures."""
    odds, right, present = found
    least = least_confidence(odds, right, precision)
    return share(right, odds >= (np.inf if least is None else least), present)


def judged(
    matches: Mapping[str, Sequence[People]], left_out: Sequence[str], columns: Sequence[int],
    precision: float, aim: float,
) -> Iterator[Row]:  # fmt: skip
    """Yield the figures of each match, of those left out, and of all: by what the others chose.

    Weights and confidence are those of the other matches, which have the precision `aim` there.
    """
    kept: dict[str, NDArray[np.bool_]] = {}
    marks: dict[str, Marks] = {}
    found = each_by_others([*matches.values()], columns, in_roi=True)
    for name, (own, others) in zip(matches, found, strict=True):
        least = least_confidence(others[0], others[1], aim)
        kept[name] = own[0] >= (np.inf if least is None else least)
        marks[name] = own
    groups = {name: [name] for name in matches} | {LEFT_OUT: [*left_out], ALL: [*matches]}
    for name, names in groups.items():
        rows = np.concatenate([kept[n] for n in names])
        right = np.concatenate([marks[n][1] for n in names])
        present = sum(marks[n][2] for n in names)
        best = recall_at(marks[name], precision) if name in marks else None
        yield {
            "data": name, "present": present, "aim": aim,
            "precision": told(right[rows]) if rows.any() else None,
            "recall": share(right, rows, present), f"recall at {precision:g}": best,
        }  # fmt: skip


def looked_by_match(looks: PeopleLooks, football: Path, split: str) -> dict[str, list[Looked]]:
    """Return who is in the stills of a part, by match."""
    names = dict.fromkeys(file.name.split("_")[0] for file in of_split(football, split))
    return {
        name: [looked(looks, still) for still in stills_of(football, split, (f"{name}_",))]
        for name in names
    }


@click.command(cls=Bench)
@click.argument("versions", nargs=-1, required=True)
@click.option("--football", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--sequence", type=click.Path(path_type=Path, exists=True), help="SoccerNet's.")
@click.option("--every", default=5, show_default=True, type=click.IntRange(1), help="Frames.")
@click.option("--precision", default=0.85, show_default=True, type=click.FloatRange(0, 1))
@click.option(
    "--aim", "aims", multiple=True, default=(0.85, 0.9), show_default=True,
    type=click.FloatRange(0, 1), help="Several times: the precision of the other matches.",
)  # fmt: skip
@JSON
def main(
    versions: Sequence[str], football: Path, sequence: Path | None, every: int, precision: float,
    aims: Sequence[float], path: Path | None,
) -> None:  # fmt: skip
    """Say how kits tell referees within a match."""
    by_kits, rows = list[Row](), list[Row]()
    for version, file, input_px in map(named, versions):
        looks = PeopleLooks(file, input_px)
        trained = looked_by_match(looks, football, TRAINING)
        unseen = looked_by_match(looks, football, "development")
        known = [*trained.values(), *unseen.values()]
        by_kits += [{"version": version} | row for row in by_kits_alone(known, precision)]
        fitted_to = [of for m in trained.values() for of in known_by(m, of_match(m))]
        weights = fitted(fitted_to, range(7), in_roi=True)
        left_out = looked_by_match(looks, football, "test")
        unseen |= left_out
        if sequence:
            unseen[sequence.name] = [looked(looks, p) for *_, p in frames_of(sequence, every)]
        told_of = {name: with_kits(match, weights) for name, match in unseen.items()}
        for aim in aims:
            for way, columns in WAYS.items():
                found = judged(told_of, [*left_out], columns, precision, aim)
                rows += [{"version": version, "told by": way} | row for row in found]
    Console().print(table("by kits alone", by_kits))
    Console().print(table("referees", rows))
    if path:
        report = facts() | {
            "bench": "match_kits", "every": every, "precision_wanted": precision,
            "by_kits_alone": by_kits, "rows": rows,
        }  # fmt: skip
        write_whole(path, json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
