"""Crops to learn appearance from: procedural scenes at full resolution -> squares of 96 pixels.

Of each moment: people and the ball, boxes disturbed as a detector in the small context disturbs
them, and what a detector might take for one: boots, hands and heads of people, marks and crossings
of lines, bits of crowd, boards and goal, empty grass, and places just beside the ball.
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from drivers.soccer import SoccerScene
from drivers.source import FrameSource, Truth
from operators.roi_features.crops import cut, to_squares
from operators.roi_features.model import CLASSES
from pipeline import Frame
from pipeline.boxes import areas, centres, from_centres, intersections
from pipeline.testing import header

CROP_PX, MARGIN = 96, 0.15
FULL_PX, RATE_HZ = (1920, 1080), 25.0
LEAST_VISIBLE = 0.4
BACKGROUND = CLASSES.index("background")
ROLES = {
    "player": "player",
    "goalkeeper": "player",
    "main referee": "referee",
    "assistant referee": "referee",
    "ball": "ball",
}
PEOPLE, BALLS, OTHERS = 8, 3, 8  # crops of a moment, at most
NOBODY = -1
Boxes = NDArray[np.float32]
Picture = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class Crops:
    """Squares of one or many moments."""

    pictures: Picture  # (n, 96, 96, 3) RGB
    kinds: NDArray[np.int64]  # (n,) index into CLASSES
    persons: NDArray[np.int64]  # (n,) who it is, the same over a scene; NOBODY: no person
    scenes: NDArray[np.int64]  # (n,)
    moments: NDArray[np.int64]  # (n,) frame


def crops_of(
    picture: Picture, boxes: Boxes, window: tuple[int, int, int, int] | None = None
) -> Picture:
    """Boxes (n, 4) of a whole picture, cut as the operator cuts them: (n, 96, 96, 3)."""
    height, width = picture.shape[:2]
    frame = Frame(header=header(), pixels=picture, window=window or (0, 0, width, height))
    found = np.empty((len(boxes), CROP_PX, CROP_PX, 3), np.uint8)
    for row, square in enumerate(to_squares(boxes, frame, MARGIN)):
        cut(picture, square, found[row])
    return found


def moment(source: FrameSource, index: int, scene: int, rng: np.random.Generator) -> Crops:
    """The crops of one frame of a source that knows the truth."""
    truth = source.truth(index)
    if truth is None:
        raise ValueError(f"frame {index}: expected a source that knows the truth, got none")
    picture = np.asarray(source.picture(index), np.uint8)
    people, balls = chosen(truth, rng)
    others = false_candidates(picture, truth, OTHERS, rng)
    rows = np.concatenate([people, np.repeat(balls, BALLS)])
    real = disturbed(truth.boxes[rows], rng)
    boxes = np.concatenate([real, others])
    kinds = [CLASSES.index(ROLES[truth.labels[row]]) for row in rows]
    persons = [int(truth.ids[row]) if row in people else NOBODY for row in rows]
    return Crops(
        pictures=crops_of(picture, boxes),
        kinds=np.array([*kinds, *[BACKGROUND] * len(others)]),
        persons=np.array([*persons, *[NOBODY] * len(others)]),
        scenes=np.full(len(boxes), scene),
        moments=np.full(len(boxes), index),
    )


def chosen(truth: Truth, rng: np.random.Generator) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of at most PEOPLE people, officials first, and of the ball, of what can be seen."""
    seen = np.array([label in ROLES for label in truth.labels], np.bool_)
    seen &= truth.visible >= LEAST_VISIBLE
    ball = np.array([label == "ball" for label in truth.labels], np.bool_)
    people = rng.permutation(np.flatnonzero(seen & ~ball))
    official = np.array([ROLES.get(truth.labels[row]) == "referee" for row in people], np.bool_)
    people = people[np.argsort(~official, kind="stable")][:PEOPLE]
    return people, np.flatnonzero(seen & ball)


def disturbed(boxes: Boxes, rng: np.random.Generator) -> Boxes:
    """Boxes as found in the context: people a little, a ball of four pixels by a lot."""
    size = boxes[:, 2:] - boxes[:, :2]
    error = np.clip(3.0 / np.sqrt(np.maximum(areas(boxes), 1)), 0.03, 0.2)[:, None]
    centre = centres(boxes) + rng.normal(size=size.shape) * size * error
    return from_centres(
        centre.astype(np.float32), (size * np.exp(rng.normal(size=size.shape) * error))
    )


def false_candidates(picture: Picture, truth: Truth, count: int, rng: np.random.Generator) -> Boxes:
    """Boxes (count, 4) of what is nothing: no ball in them, and nobody as a whole."""
    height, width = picture.shape[:2]
    found: list[NDArray[np.float64]] = []
    people = truth.boxes[[label != "ball" for label in truth.labels]]
    while len(found) < count:
        small = rng.random() < 0.7
        side = rng.uniform(10, 26) if small else rng.uniform(60, 200)
        shape = np.array([side, side if small else side * rng.uniform(1.8, 2.6)])
        place = rng.random(2) * (width, height)
        draw = rng.random()
        if small and draw < 0.45 and len(people):
            left, top, right, bottom = people[rng.integers(len(people))]
            share = rng.choice([0.96, 0.96, 0.06, 0.5])  # boots twice, head, hands
            place = np.array([rng.uniform(left, right), top + share * (bottom - top)])
        elif small and draw < 0.75:
            place = bright_place(picture, rng)
        box = np.concatenate([place - shape / 2, place + shape / 2])
        if free(box, truth, small):
            found.append(box)
    return np.array(found, np.float32)


def bright_place(picture: Picture, rng: np.random.Generator) -> NDArray[np.float64]:
    """The brightest of some places: lines, spots, letters, shirts."""
    places = (rng.random((32, 2)) * (picture.shape[1] - 1, picture.shape[0] - 1)).astype(int)
    light = picture[places[:, 1], places[:, 0]].astype(int).sum(1)
    return np.asarray(places[light.argmax()], np.float64)


def free(box: NDArray[np.float64], truth: Truth, small: bool) -> bool:
    """Whether a box holds no ball, and if it is large no person."""
    if not len(truth.boxes):
        return True
    own = box.astype(np.float32)[None]
    shared = intersections(truth.boxes, own)[:, 0]
    ball = np.array([label == "ball" for label in truth.labels], np.bool_)
    if shared[ball].any():
        return False
    return small or not (shared[~ball] > 0.15 * areas(own)[0]).any()


def render(
    seeds: Iterable[int], count: int, span: int, folder: Path, workers: int = 2
) -> list[Path]:
    """Crops of `count` moments of each seed's scene on disk; those already there are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    wanted = {seed: folder / f"{seed}.npz" for seed in seeds}
    missing = [seed for seed, path in wanted.items() if not path.exists()]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(_render_scene, seed, count, span, wanted[seed]) for seed in missing]
        for job in tqdm(jobs, desc="crops", unit="scene", disable=not jobs):
            job.result()
    return list(wanted.values())


def _render_scene(seed: int, count: int, span: int, path: Path) -> None:
    cv2.setNumThreads(1)
    rng = np.random.default_rng([seed, 6])
    scene = SoccerScene(size_px=FULL_PX, rate_hz=RATE_HZ, seed=seed)
    frames = (rng.random(count) + np.arange(count)) * span / count
    found = joined(moment(scene, int(frame), seed, rng) for frame in frames)
    scene.close()
    unfinished = path.with_suffix(".part.npz")
    np.savez(unfinished, allow_pickle=False, **vars(found))
    unfinished.rename(path)


def load(paths: Iterable[Path]) -> Crops:
    """What `render` left, all scenes together."""

    def each() -> Iterator[Crops]:
        for path in paths:
            with np.load(path) as file:
                yield Crops(**dict(file))

    return joined(each())


def joined(parts: Iterable[Crops]) -> Crops:
    """Many as one."""
    kept = list(parts)
    names = Crops.__dataclass_fields__
    return Crops(**{name: np.concatenate([getattr(part, name) for part in kept]) for name in names})
