"""Pieces of pictures to train a tracker with: scenes, stills and videos -> squares with an object.

A piece is seven sizes of its object wide and resized to 224 px, so that the object takes 32 px as
in a look. Two pieces of the same object make a pair: of a scene at two moments; of a still the same
piece twice, for motion that is made up.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.datasets.pictures import read_picture
from drivers.datasets.video import VideoFile
from drivers.scenes.soccer import SoccerScene
from operators.tracker.look import size_of
from operators.training.arrays import Arrays, claim, outdated, read, write
from operators.training.identity import DIGITS, Identity, of_code
from operators.training.progress import tracked
from operators.training.splits import HELD_OUT
from operators.training.stills import PICTURES, labels_of, read_rows
from operators.training.workers import pool_of
from pipeline.boxes import centres, from_centres
from pipeline.errors import DriverError
from pipeline.fleet.placement import file_digest

PIECE_PX, ACROSS = 224, 7  # side of a piece, and how many sizes of the object that is
TRAIN_SEEDS = 33_000  # no other part of the project uses them
OF_STILL, OF_MOMENT, OF_VIDEO = 16, 8, 24  # objects of a still and a moment; pictures of a video
GAPS = (1, 40)  # frames between the two moments of a pair
LEAST_PX, LEAST_SEEN = 6.0, 0.5
# names of files and folders that begin like this are never read; the last is a clip for evaluation
NEVER_READ = (*HELD_OUT, "SNMOT-116")
Box = NDArray[np.float32]  # (4,) xyxy
Picture = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """Squares around objects, and which two show the same object."""

    pictures: Picture  # (m, 224, 224, 3) RGB
    boxes: NDArray[np.float32]  # (m, 4) xyxy, pixels of the piece
    scales: NDArray[np.float32]  # (m,) pixels of the piece per pixel of its picture
    pairs: NDArray[np.int64]  # (n, 2) rows


def piece(picture: Picture, box: Box) -> tuple[Picture, Box, float]:
    """Cut the piece around a box: pixels, the box in them, and pixels per pixel of the picture."""
    side = ACROSS * size_of(box)
    scale = PIECE_PX / side
    shift = PIECE_PX / 2 - centres(box) * scale
    half = 0.5 * scale - 0.5  # pixel centres lie at halves
    matrix = np.array([[scale, 0, shift[0] + half], [0, scale, shift[1] + half]])
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    if scale < 0.7:  # a warp does not average
        soft = 0.5 / scale
        left, top = np.maximum(centres(box) - side, 0).astype(int)
        right, bottom = np.ceil(centres(box) + side).astype(int)
        cut = cv2.GaussianBlur(picture[top:bottom, left:right], (0, 0), soft * 0.6)
        matrix[:, 2] += matrix[:, :2] @ np.array([left, top])
        picture, way = np.asarray(cut, np.uint8), cv2.INTER_LINEAR
    size = (PIECE_PX, PIECE_PX)
    found = cv2.warpAffine(picture, matrix, size, flags=way, borderMode=cv2.BORDER_REPLICATE)
    own = box * np.float32(scale) + np.tile(shift, 2)
    return np.asarray(found, np.uint8), own.astype(np.float32), float(scale)


def prepare(
    folder: Path, scenes: int, moments: int, stills: tuple[Path, ...], phase: str, workers: int = 1
) -> list[Path]:
    """Make missing files of pieces, and those of pictures or labels that changed.

    Raises `DriverError` for a source that cannot be read, and for two of one name.
    """
    code = of_code("operators.tracker.pieces", "drivers.scenes.soccer:SoccerScene")
    wanted: dict[Path, int | Path] = {}
    for seed in range(TRAIN_SEEDS, TRAIN_SEEDS + scenes):
        wanted[folder / f"scene_{seed}_{moments}.npz"] = seed
    for place in stills:
        for path in sources_of(place):
            claim(wanted, folder / f"{place.parent.name}_{place.name}_{path.stem}.npz", path)
    folder.mkdir(parents=True, exist_ok=True)
    made = {file: code | _contents(source) for file, source in wanted.items()}
    missing = outdated(wanted, made.__getitem__, print)
    with pool_of(workers) as pool:
        jobs = [pool.submit(_cut, path, wanted[path], moments, made[path]) for path in missing]
        for job in tracked(jobs, phase):
            job.result()
    return list(wanted)


def _cut(path: Path, source: int | Path, moments: int, made: Identity) -> None:
    cv2.setNumThreads(1)
    found = of_scene(source, moments) if isinstance(source, int) else of_source(source)
    write_pieces(path, found, made)


def contents(stills: Iterable[Path]) -> str:
    """What is in all sources of some folders, as a text that differs where they differ."""
    known = [
        path.name + _contents(path)["source"] for place in stills for path in sources_of(place)
    ]
    return f"{len(known)} files, {sha256(''.join(known).encode()).hexdigest()[:DIGITS]}"


def _contents(source: int | Path) -> dict[str, str]:
    """What a file of pieces is made of, besides code: a picture and its labels, or a video."""
    if isinstance(source, int):
        return {}
    labels = labels_of(source)
    known = file_digest(source) + (file_digest(labels) if labels.is_file() else "")
    return {"source": sha256(known.encode()).hexdigest()[:DIGITS]}


def sources_of(place: Path) -> list[Path]:
    """Pictures below a folder, or a video, without those held out; raises `DriverError`."""
    if place.is_file():
        found = [place]
    else:
        below = place / "images" if (place / "images").is_dir() else place
        found = sorted(p for p in below.glob("*") if p.suffix.lower() in PICTURES)
    kept = [p for p in found if not any(part.startswith(NEVER_READ) for part in p.parts)]
    if not kept:
        raise DriverError(f"{place}: expected pictures or a video that are not held out, got none")
    return kept


Item = tuple[Picture, Box, float]


def of_scene(seed: int, moments: int) -> Iterator[tuple[Item, ...]]:
    """Pairs of a scene: the ball and some people, at two moments each."""
    scene, rng = SoccerScene(seed=seed), np.random.default_rng([seed, 40])
    starts = np.sort(rng.integers(0, 900, moments))
    for start in starts:
        frames = (int(start), int(start + rng.integers(*GAPS)))
        views: list[dict[int, Item]] = []
        wanted: list[int] = []
        for frame in frames:
            truth = scene.truth(frame)
            seen = truth.visibility >= LEAST_SEEN
            if not wanted:
                balls = [
                    i for i, label in zip(truth.ids, truth.labels, strict=True) if label == "ball"
                ]
                others = [int(i) for i in truth.ids[seen] if i not in balls]
                wanted = [*map(int, balls), *rng.permutation(others)[: OF_MOMENT - 1].tolist()]
            picture = scene.picture(frame)
            rows = {int(truth.ids[r]): truth.boxes[r] for r in np.flatnonzero(seen)}
            views.append(
                {i: piece(picture, rows[i]) for i in wanted if inside(rows.get(i), picture)}
            )
        yield from (tuple(view[i] for view in views) for i in wanted if all(i in v for v in views))
    scene.close()


def of_source(path: Path) -> Iterator[tuple[Item, ...]]:
    """Pieces of a still, with and without labels, or of two near pictures of a video."""
    rng = np.random.default_rng(list(path.stem.encode())[:64])
    if path.suffix.lower() in PICTURES:
        picture = read_picture(path)
        boxes = [b for b in boxes_of(path, picture) if inside(b, picture)]
        order = sorted(range(len(boxes)), key=lambda k: size_of(boxes[k]))
        rest = rng.permutation(order[2:])[: OF_STILL - 2]
        chosen = [*order[:2], *rest.tolist()]  # the smallest is mostly the ball
        for box in [*(boxes[k] for k in chosen), *anything(picture, rng, 2)]:
            yield (piece(picture, box),)
        return
    video = VideoFile(path=str(path))
    for index in np.linspace(0, (video.length or 1) - 1, OF_VIDEO).astype(int):
        picture = video.picture(int(index))
        for box in anything(picture, rng, 4):
            yield (piece(picture, box),)
    video.close()


def anything(picture: Picture, rng: np.random.Generator, count: int) -> Iterator[Box]:
    """Boxes of no object, at places of some structure."""
    height, width = picture.shape[:2]
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    for _ in range(count):
        tried = []
        for _ in range(6):
            size = np.exp(rng.uniform(np.log(10), np.log(90)))
            sides = size * np.exp(rng.normal(0, 0.3) * np.array([-1, 1]))
            place = rng.uniform(sides, np.array([width, height]) - sides)
            box = from_centres(place.astype(np.float32), sides.astype(np.float32))
            left, top, right, bottom = box.astype(int)
            tried.append((float(grey[top:bottom, left:right].std()), box))
        yield max(tried, key=lambda found: found[0])[1]


def boxes_of(path: Path, picture: Picture) -> Iterator[Box]:
    """Boxes of a picture in a folder `images/` with `labels/` beside; none without such."""
    file = labels_of(path)
    if not file.is_file():
        return
    size = np.array([picture.shape[1], picture.shape[0]], np.float32)
    for _, x, y, width, height in read_rows(file):
        middle = np.array([x, y], np.float32) * size
        yield from_centres(middle, np.array([width, height], np.float32) * size)


def inside(box: Box | None, picture: Picture) -> bool:
    """Whether an object is large enough and not at the picture's edge."""
    if box is None:
        return False
    height, width = picture.shape[:2]
    whole = (box[:2] >= 0).all() and box[2] <= width and box[3] <= height
    return bool(whole and size_of(box) >= LEAST_PX)


def write_pieces(path: Path, found: Iterator[tuple[Item, ...]], made: Identity) -> None:
    """Keep what a source gave; a file may hold nothing."""
    groups = list(found)
    items = [item for group in groups for item in group]
    ends = np.cumsum([0, *map(len, groups)])
    pairs = [(begin, end - 1) for begin, end in pairwise(ends)]
    arrays: Arrays = {
        "pictures": np.array([i[0] for i in items], np.uint8).reshape(-1, PIECE_PX, PIECE_PX, 3),
        "boxes": np.array([i[1] for i in items], np.float32).reshape(-1, 4),
        "scales": np.array([i[2] for i in items], np.float32),
        "pairs": np.array(pairs, np.int64).reshape(-1, 2),
    }
    write(path, arrays, made)


def load(files: list[Path]) -> Pieces:
    """All pieces of some files; raises `DriverError` where there are none."""
    parts = [read(file) for file in files]
    counts = np.cumsum([0, *(len(part["pictures"]) for part in parts)])
    if not sum(len(part["pairs"]) for part in parts):
        raise DriverError(f"{files[0].parent}: expected objects to train with, got none")
    joined = {n: np.concatenate([p[n] for p in parts]) for n in ("pictures", "boxes", "scales")}
    pairs = [part["pairs"] + first for part, first in zip(parts, counts[:-1], strict=True)]
    return Pieces(**joined, pairs=np.concatenate(pairs))
