"""Training crops of the encoder: procedural scenes at full resolution -> squares of 96 pixels.

Each moment yields people and the ball, in boxes perturbed like those of a detector on the context,
and false balls: boots, bright sleeves, socks and numbers of people, small white objects (marks and
crossings of lines, letters, bits of crowd, the goal), grass.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer import SoccerScene
from drivers.source import CLASS_OF_ROLE, Annotations, FrameSource
from operators.roi_features.crops import cut, to_squares
from operators.roi_features.model import CLASSES
from operators.training.arrays import outdated, read, write
from operators.training.identity import Identity, of_code
from operators.training.progress import tracked
from operators.training.workers import pool_of
from pipeline import Frame
from pipeline.boxes import areas, centres, from_centres, intersections
from pipeline.errors import DriverError
from pipeline.testing import header

CROP_PX, MARGIN = 96, 0.15
FULL_PX, RATE_HZ = (1920, 1080), 25.0
LEAST_SEEN = 0.4
BACKGROUND = CLASSES.index("background")
ANYONE = len(CLASSES)  # a person of whom it is not told which of the classes
PEOPLE, BALLS, OTHERS = 8, 3, 12  # crops of a moment, at most
NOBODY = -1
Boxes = NDArray[np.float32]
Picture = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class Crops:
    """Squares of one or many moments."""

    pictures: Picture  # (n, 96, 96, 3) RGB
    kinds: NDArray[np.int64]  # (n,) index into CLASSES, or ANYONE
    persons: NDArray[np.int64]  # (n,) id, constant over a scene; NOBODY: no person
    scenes: NDArray[np.int64]  # (n,)
    moments: NDArray[np.int64]  # (n,) frame


def whole(picture: Picture) -> Frame:
    """A picture as a frame that shows all the sensor sees."""
    height, width = picture.shape[:2]
    return Frame(header=header(), pixels=picture, window=(0, 0, width, height))


def crops_of(picture: Picture, boxes: Boxes) -> Picture:
    """Boxes (n, 4) of a whole picture, cut as the operator cuts them: (n, 96, 96, 3)."""
    found = np.empty((len(boxes), CROP_PX, CROP_PX, 3), np.uint8)
    squares = to_squares(boxes, whole(picture), MARGIN)
    for row, crop in enumerate(cut(picture, squares, (CROP_PX, CROP_PX))):
        found[row] = crop
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """Possible detections in one picture, with their true class."""

    picture: Picture  # (h, w, 3) RGB
    boxes: Boxes  # (n, 4) its pixels
    kinds: NDArray[np.int64]  # (n,) index into CLASSES
    persons: NDArray[np.int64]  # (n,) NOBODY: no person


def candidates(
    source: FrameSource, index: int, rng: np.random.Generator, people: int = PEOPLE
) -> Candidates:
    """Boxes in one frame of a source that knows the truth: at most `people`, ball, false ones."""
    truth = source.truth(index)
    if truth is None:
        raise DriverError(f"frame {index}: expected a source that knows the truth, got none")
    picture = np.array(source.picture(index), np.uint8)  # the source reuses its memory
    persons, balls = chosen(truth, rng, people)
    rows = np.concatenate([persons, np.repeat(balls, BALLS)])
    others = false_candidates(picture, truth, OTHERS, rng)
    return Candidates(
        picture=picture,
        boxes=np.concatenate([disturbed(truth.boxes[rows], rng), others]),
        kinds=np.array(
            [
                *(CLASSES.index(CLASS_OF_ROLE[truth.labels[row]]) for row in rows),
                *[BACKGROUND] * OTHERS,
            ]
        ),
        persons=np.concatenate(
            [truth.ids[persons], np.full(len(rows) - len(persons) + OTHERS, NOBODY)]
        ).astype(np.int64),
    )


def moment(source: FrameSource, index: int, scene: int, rng: np.random.Generator) -> Crops:
    """The crops of one frame of a source that knows the truth."""
    return cut_out(candidates(source, index, rng), scene, index)


def cut_out(found: Candidates, scene: int, moment: int) -> Crops:
    """The crops of candidates in a picture, numbered by its scene and moment."""
    return Crops(
        pictures=crops_of(found.picture, found.boxes),
        kinds=found.kinds,
        persons=found.persons,
        scenes=np.full(len(found.boxes), scene),
        moments=np.full(len(found.boxes), moment),
    )


def chosen(
    truth: Annotations, rng: np.random.Generator, most: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows of at most so many visible people, officials first, and of the ball."""
    seen = np.array([label in CLASS_OF_ROLE for label in truth.labels], np.bool_)
    seen &= truth.visibility >= LEAST_SEEN
    ball = np.array([label == "ball" for label in truth.labels], np.bool_)
    people = rng.permutation(np.flatnonzero(seen & ~ball))
    official = np.array(
        [CLASS_OF_ROLE.get(truth.labels[row]) == "referee" for row in people], np.bool_
    )
    people = people[np.argsort(~official, kind="stable")][:most]
    return people, np.flatnonzero(seen & ball)


def disturbed(boxes: Boxes, rng: np.random.Generator) -> Boxes:
    """Perturb boxes like detections in the context: people a little, a small ball strongly."""
    size = boxes[:, 2:] - boxes[:, :2]
    error = np.clip(3.0 / np.sqrt(np.maximum(areas(boxes), 1)), 0.03, 0.2)[:, None]
    centre = centres(boxes) + rng.normal(size=size.shape) * size * error
    return from_centres(
        centre.astype(np.float32), (size * np.exp(rng.normal(size=size.shape) * error))
    )


def false_candidates(
    picture: Picture, truth: Annotations, count: int, rng: np.random.Generator
) -> Boxes:
    """Return boxes (count, 4) of false candidates, with neither a ball nor a whole person."""
    height, width = picture.shape[:2]
    found: list[NDArray[np.float64]] = []
    standing_out = outstanding(picture, rng)
    people = truth.boxes[[label != "ball" for label in truth.labels]]
    while len(found) < count:
        small = rng.random() < 0.75
        side = np.exp(rng.uniform(*np.log((10, 40)))) if small else rng.uniform(60, 200)
        shape = np.array([side, side if small else side * rng.uniform(1.8, 2.6)])
        place = rng.random(2) * (width, height)
        draw = rng.random()
        if small and draw < 0.5 and len(people):
            place = on_person(picture, people[rng.integers(len(people))], rng)
        elif small and draw < 0.85:
            place = standing_out[rng.integers(len(standing_out))] + rng.normal(size=2) * side / 8
        box = np.concatenate([place - shape / 2, place + shape / 2])
        if free(box, truth, small):
            found.append(box)
    return np.array(found, np.float32)


def on_person(picture: Picture, box: Boxes, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a position on a person: at the boots, at a bright spot, or anywhere."""
    left, top, right, bottom = box
    if rng.random() < 0.3:
        return np.array([rng.uniform(left, right), bottom - 0.04 * (bottom - top)])
    places = rng.uniform((left, top), (right, bottom), (int(rng.choice([1, 6])), 2))
    limits = np.array(picture.shape[1::-1]) - 1
    columns, rows = np.clip(places, 0, limits).astype(int).T
    return np.asarray(places[picture[rows, columns].min(1).argmax()], np.float64)


def outstanding(picture: Picture, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return positions (64, 2) with about the contrast of a ball."""
    light = picture.min(2).astype(np.int16)
    contrast = light - cv2.blur(picture.min(2), (41, 41))
    rows, columns = np.nonzero(contrast > 40)
    if not len(rows):
        return rng.random((64, 2)) * picture.shape[1::-1]
    # most are in the stands: take half of the positions from the lower part of the picture
    low = np.flatnonzero(rows > picture.shape[0] * 0.4)
    drawn = rng.integers(len(rows), size=64)
    if len(low):
        drawn[32:] = low[rng.integers(len(low), size=32)]
    return np.stack([columns[drawn], rows[drawn]], 1).astype(np.float64)


def free(box: NDArray[np.float64], truth: Annotations, small: bool) -> bool:
    """Whether a box holds no ball, and if it is large no person."""
    if not len(truth.boxes):
        return True
    own = box.astype(np.float32)[None]
    shared = intersections(truth.boxes, own)[:, 0]
    ball = np.array([label == "ball" for label in truth.labels], np.bool_)
    if shared[ball].any():
        return False
    return small or not (shared[~ball] > 0.15 * areas(own)[0]).any()


def made_with(count: int, span: int) -> dict[str, str]:
    """Return what determines the crops of a scene besides its seed."""
    code = of_code(
        "drivers.scenes.soccer", "operators.roi_features.data", "operators.roi_features.crops"
    )
    return code | {"moments": str(count), "span": str(span)}


def render(
    seeds: Iterable[int], count: int, span: int, folder: Path, workers: int = 2,
    name: str = "draw crops",
) -> list[Path]:  # fmt: skip
    """Render crops of `count` moments of each seed's scene to disk, unless they exist.

    Files that are damaged, or were rendered with other settings or code, are rendered again.
    """
    made = made_with(count, span)
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [folder / f"{seed}.npz" for seed in seeds]
    missing = outdated(wanted, made, print)
    with pool_of(workers) as pool:
        jobs = [pool.submit(_render_scene, path, count, span, made) for path in missing]
        for job in tracked(jobs, name):
            job.result()
    return wanted


def _render_scene(path: Path, count: int, span: int, made: Identity) -> None:
    cv2.setNumThreads(1)
    seed = int(path.stem)
    rng = np.random.default_rng([seed, 6])
    scene = SoccerScene(size_px=FULL_PX, rate_hz=RATE_HZ, seed=seed)
    frames = (rng.random(count) + np.arange(count)) * span / count
    found = joined(moment(scene, int(frame), seed, rng) for frame in frames)
    scene.close()
    write(path, vars(found), made)


def load(paths: Iterable[Path]) -> Crops:
    """Load the files of `render`, all scenes together."""
    return joined(Crops(**read(path)) for path in paths)


def joined(parts: Iterable[Crops]) -> Crops:
    """Concatenate crops."""
    kept = list(parts)
    names = Crops.__dataclass_fields__
    return Crops(**{name: np.concatenate([getattr(part, name) for part in kept]) for name in names})
