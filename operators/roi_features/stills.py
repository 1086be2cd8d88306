"""Training crops of labelled stills: real people, the real ball, and what is taken for a ball.

False balls are those that the shipped detector reports in the context of the still, at a threshold
so low that it finds about twenty: the candidates that a policy meets. A person of a still is seen
once, so that both crops of a pair are the same view, disturbed differently. People of stills are
only people: the kits of seven matches teach nothing about the referees of another (trained with
their classes, the chance to rate a true referee above a false one fell from .87 to .67 on the test
matches).
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.source import Annotations
from operators.roi_features.data import (
    ANYONE,
    BALLS,
    NOBODY,
    OTHERS,
    Boxes,
    Candidates,
    cut_out,
    disturbed,
    false_candidates,
    free,
)
from operators.roi_features.model import CLASSES
from operators.training.arrays import claim, outdated, write
from operators.training.identity import Identity, of_code
from operators.training.progress import each_of
from operators.training.splits import HELD_OUT
from operators.training.stills import CLASSES as KINDS
from operators.training.stills import class_names, contents, labelled, pictures_of
from pipeline.errors import DriverError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.shipped import TASKS, source_path
from pipeline.messages import Detections, Message
from pipeline.run.inline import InlineRunner

FULL_PX = (1920, 1080)  # of the stills; others are scaled to it, as the loop sees them
LEAST_SCORE = 0.03  # of a detection, to be a candidate
DETECTED, VIEWS = 20, 2  # false candidates of a still, the surest first; crops of each person
FIRST_SCENE = 1_000_000  # numbers of stills, behind those of scenes


def of_training(folder: Path) -> list[Path]:
    """The stills of a folder but those held out; raises `DriverError` where none is left."""
    found = [path for path in pictures_of(folder) if not path.name.startswith(HELD_OUT)]
    if not found:
        raise DriverError(f"{folder}: expected stills beside those held out, got none")
    return found


def truth_of(path: Path, names: Mapping[int, str]) -> tuple[NDArray[np.uint8], Annotations]:
    """A still of `FULL_PX` and what is in it; raises `DriverError` with file and line."""
    still = labelled(path)
    height, width = still.picture.shape[:2]
    gain = np.array([FULL_PX[0] / width, FULL_PX[1] / height] * 2, np.float32)
    picture = still.picture
    if (width, height) != FULL_PX:
        picture = np.asarray(cv2.resize(picture, FULL_PX, interpolation=cv2.INTER_AREA), np.uint8)
    unknown = sorted({int(n) for n in still.numbers} - set(names))
    if unknown:
        raise DriverError(f"{path}: expected classes of data.yaml, got {unknown[0]}")
    count = len(still.numbers)
    truth = Annotations(
        boxes=still.boxes * gain,
        ids=np.arange(count, dtype=np.int32),
        labels=tuple(KINDS[names[int(n)]] for n in still.numbers),
        visibility=np.ones(count, np.float32),
    )
    return picture, truth


def detected(paths: Iterable[Path]) -> Iterator[Detections]:
    """What the shipped detector finds in the contexts of pictures of one size, in their order."""
    found: list[Detections] = []

    def keep(output: str, message: Message) -> None:
        if output == "saliency.out" and isinstance(message, Detections):
            found.append(message)

    with TemporaryDirectory() as folder:
        for place, path in enumerate(paths):
            (Path(folder) / f"{place:06d}{path.suffix}").symlink_to(path.resolve())
        changes = (
            f"capture.path={folder}", "capture.strategy=full", "capture.rate_hz=25",
            f"saliency.confidence={LEAST_SCORE}",
        )  # fmt: skip
        overlay = Overlay(source=source_path("images"), changes=changes, clock="lockstep")
        plan = load(TASKS / "tracking_recording.yaml", overlay)
        with InlineRunner(plan, watch=keep) as run:
            for _ in run.run():
                yield found.pop()
                found.clear()


def candidates_of(
    picture: NDArray[np.uint8], truth: Annotations, seen: Detections, rng: np.random.Generator
) -> Candidates:
    """Everybody, the ball, and false balls: those detected and as many of a scene's kinds."""
    ball = np.array([label == "ball" for label in truth.labels], np.bool_)
    people = np.repeat(np.flatnonzero(~ball), VIEWS)
    rows = np.concatenate([people, np.repeat(np.flatnonzero(ball), 2 * BALLS)])
    others = np.zeros((0, 4), np.float32)
    if ball.any():  # else a false ball could be the ball, which nobody marked
        drawn = false_candidates(picture, truth, OTHERS, rng)
        others = np.concatenate([false_balls(seen, truth), drawn])
    persons = np.where(ball[rows], NOBODY, truth.ids[rows])
    return Candidates(
        picture=picture,
        boxes=np.concatenate([disturbed(truth.boxes[rows], rng), others]),
        kinds=np.array(
            [
                *(CLASSES.index("ball") if ball[row] else ANYONE for row in rows),
                *[CLASSES.index("background")] * len(others),
            ]
        ),
        persons=np.concatenate([persons, np.full(len(others), NOBODY)]).astype(np.int64),
    )


def false_balls(seen: Detections, truth: Annotations) -> Boxes:
    """Return the surest detected balls (n, 4) that are none, at most `DETECTED`."""
    order = np.argsort(-seen.scores, kind="stable")
    balls = order[seen.labels[order] == seen.names.index("ball")]
    found = [box for box in seen.boxes[balls] if free(box, truth, True)]
    return np.array(found[:DETECTED], np.float32).reshape(-1, 4)


def made_with() -> dict[str, str]:
    """Return what determines the crops of a still besides its picture and labels."""
    return of_code(
        "operators.roi_features.stills", "operators.roi_features.data",
        "operators.roi_features.crops", "operators.saliency",
    )  # fmt: skip


def prepare(folder: Path, stills: Iterable[Path], phase: str) -> list[Path]:
    """Write missing crops of the stills of some folders; those held out are never read.

    Those of a folder are made again where any of its stills, labels or names of classes changed.
    Raises `DriverError` for a folder without labelled stills, and for two stills of one name.
    """
    wanted = dict[Path, Path]()
    folder.mkdir(parents=True, exist_ok=True)
    for place in dict.fromkeys(stills):
        found = of_training(place)
        first = len(wanted)  # people of two stills with one number would be taken for the same
        made = made_with() | {"stills": contents(found), "first": str(first)}
        for path in found:
            claim(wanted, folder / f"{place.name}_{path.stem}.npz", path)
        numbers = {file: FIRST_SCENE + k for k, file in enumerate(wanted) if k >= first}
        if missing := outdated(numbers, made, print):
            files = {file: (numbers[file], wanted[file]) for file in missing}
            write_all(files, class_names(place / "data.yaml"), made, phase)
    return list(wanted)


def write_all(
    files: Mapping[Path, tuple[int, Path]], names: Mapping[int, str], made: Identity, phase: str
) -> None:
    """Write the crops of stills: each file's number and still."""
    looks = zip(files.items(), detected(still for _, still in files.values()), strict=True)
    for (file, (number, path)), seen in each_of(looks, phase, len(files)):
        picture, truth = truth_of(path, names)
        found = candidates_of(picture, truth, seen, np.random.default_rng([number, 6]))
        write(file, vars(cut_out(found, number, 0)), made)
