"""Training samples of a tracker: pieces -> a template, a search picture, and where the object is.

Looks come from `look.py`, as they do live: the context, shrunk and enlarged again, and a sharp ROI
that shows all, a part or nothing of it. Four kinds of samples: an object at two moments; something
pasted on two grounds; the same with others beside it; and a search picture without the object.
Where the second moment is made up, the piece is turned and stretched, and three in ten are smeared.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.tracker.look import Streams, size_of
from operators.tracker.pieces import ACROSS, PIECE_PX, Pieces
from operators.tracker.template import (
    CELLS,
    SEARCH_FACTOR,
    SEARCH_PX,
    TEMPLATE_FACTOR,
    TEMPLATE_PX,
    shape_of,
)
from operators.training.photometric import degrade, recolour
from pipeline import Frame
from pipeline.boxes import centres, from_centres
from pipeline.testing import header

ABSENT, PASTED = 0.2, 0.35  # shares of samples
SMALL, SMALL_PX = 0.35, 20.0  # share of objects that are surely smaller than this
TURN_DEG, STRETCH = 7.0, 0.07  # between two moments that are made up; standard deviations
SMEARED, SMEAR = 0.3, 0.5  # share of them, and how far at most, in sizes
SHIFT = 1.2  # largest distance of the object from a search picture's middle, in sizes
NEAR = 1.5  # cells from the object's middle that learn its place and size
NOTHING = np.zeros((0, 0, 3), np.uint8)
Box = NDArray[np.float32]  # (4,) xyxy
Picture = NDArray[np.uint8]
Arrays = dict[str, NDArray[np.float32] | Picture]


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A piece as a sensor would see it, and the object in it."""

    picture: Picture  # (224, 224, 3)
    box: Box
    scale: float


def streams_of(scene: Scene, rng: np.random.Generator) -> Streams:
    """Context and ROI of a piece: the context at 1/2 to 1/8, mostly 1/4; the ROI by chance."""
    coarse = scene.scale * float(rng.choice([2, 4, 4, 4, 8]))
    side = int(np.clip(PIECE_PX / max(coarse, 1.0), 8, PIECE_PX))
    small = cv2.resize(scene.picture, (side, side), interpolation=cv2.INTER_AREA)
    field = (0, 0, PIECE_PX, PIECE_PX)
    context = Frame(header=header(), pixels=np.asarray(small, np.uint8), window=field)
    draw = rng.random()
    if draw < 0.25:
        roi = Frame(header=header(), pixels=NOTHING)
    elif draw < 0.7:
        roi = Frame(header=header(), pixels=scene.picture, window=field)
    else:  # its edge runs near the object
        low = np.where(rng.random(2) < 0.5, 0, rng.integers(0, PIECE_PX - 64, 2))
        high = np.where(rng.random(2) < 0.5, PIECE_PX, low + rng.integers(48, PIECE_PX, 2))
        left, top, right, bottom = map(int, (*low, *np.minimum(high, PIECE_PX)))
        shown = np.ascontiguousarray(scene.picture[top:bottom, left:right])
        roi = Frame(header=header(), pixels=shown, window=(left, top, right, bottom))
    return Streams(context=context, roi=roi)


def pasted(under: Scene, patch: Picture, mask: NDArray[np.float32], at: Box) -> Picture:
    """Lay a patch over a piece, into a box, turned and softened as its mask says."""
    left, top, right, bottom = np.clip(at.round(), 0, PIECE_PX).astype(int)
    found = under.picture.copy()
    if right - left < 2 or bottom - top < 2:
        return found
    size = (int(right - left), int(bottom - top))
    alpha = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)[..., None]
    over = cv2.resize(patch, size, interpolation=cv2.INTER_AREA)
    ground = found[top:bottom, left:right]
    found[top:bottom, left:right] = (alpha * over + (1 - alpha) * ground).astype(np.uint8)
    return found


def thing(pieces: Pieces, rng: np.random.Generator) -> tuple[Picture, NDArray[np.float32]]:
    """Something to paste: a cut-out of a piece in the form of a disc or a polygon, and its mask."""
    whole = pieces.pictures[int(rng.integers(len(pieces.pictures)))]
    side = int(rng.integers(24, 72))
    left, top = rng.integers(60, PIECE_PX - 60 - side // 2, 2)
    patch = cv2.resize(whole[top : top + side, left : left + side], (64, 64))
    lit = recolour(np.asarray(patch, np.uint8), rng)
    mask = np.zeros((64, 64), np.float32)
    if rng.random() < 0.5:
        cv2.ellipse(mask, (32, 32), (31, 31), 0, 0, 360, 1.0, -1, cv2.LINE_AA)
    else:
        turns = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(4, 9))))
        reach = rng.uniform(20, 34, len(turns))
        corners = 32 + np.stack([np.cos(turns), np.sin(turns)], 1) * reach[:, None]
        corners = (corners - corners.min(0)) / np.maximum(np.ptp(corners, axis=0), 1) * 63
        cv2.fillPoly(mask, [corners.astype(np.int32)], 1.0, cv2.LINE_AA)
    return lit, mask


def scene_of(pieces: Pieces, row: int) -> Scene:
    """A row as it is."""
    return Scene(
        picture=pieces.pictures[row], box=pieces.boxes[row], scale=float(pieces.scales[row])
    )


def shifted(scene: Scene, rng: np.random.Generator) -> Scene:
    """The same piece moved aside, so that what is pasted does not always hide its object."""
    x, y = rng.uniform(-70, 70, 2)
    matrix = np.array([[1, 0, x], [0, 1, y]], np.float32)
    size = (PIECE_PX, PIECE_PX)
    moved = cv2.warpAffine(scene.picture, matrix, size, borderMode=cv2.BORDER_REFLECT_101)
    box = (scene.box + np.array([x, y, x, y])).astype(np.float32)
    return Scene(picture=np.asarray(moved, np.uint8), box=box, scale=scene.scale)


def changed(scene: Scene, rng: np.random.Generator) -> Scene:
    """The piece some moments later: turned and stretched, and sometimes smeared by motion."""
    middle, sides = centres(scene.box), scene.box[2:] - scene.box[:2]
    stretch = np.exp(rng.normal(0, STRETCH, 2))
    turn = np.deg2rad(rng.normal(0, TURN_DEG))
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) * stretch
    fixed = middle - 0.5  # boxes are of edges; OpenCV maps pixels by their number
    matrix = np.concatenate([matrix, (fixed - matrix @ fixed)[:, None]], 1)
    size = (PIECE_PX, PIECE_PX)
    picture = cv2.warpAffine(scene.picture, matrix, size, borderMode=cv2.BORDER_REFLECT_101)
    sides = sides * stretch
    # of an ellipse in the box: a rectangle would get wider than what people fill
    sides = np.hypot(sides * np.cos(turn), sides[::-1] * np.sin(turn))
    if rng.random() < SMEARED:
        angle = rng.uniform(0, 2 * np.pi)
        way = np.array([np.cos(angle), np.sin(angle)]) * rng.uniform(0, SMEAR) * size_of(scene.box)
        picture = cv2.filter2D(picture, -1, line(way))
        sides = sides + np.abs(way) / 2  # to where half of the light is left
    box = from_centres(middle, sides.astype(np.float32))
    return Scene(picture=np.asarray(picture, np.uint8), box=box, scale=scene.scale)


def line(way: NDArray[np.float64]) -> NDArray[np.float32]:
    """A kernel (k, k) of sum 1 that smears a picture along `way` (x, y), in pixels.

    >>> line(np.array([4.0, 0.0]))[2].astype(float).round(1).tolist()
    [0.1, 0.2, 0.2, 0.2, 0.1]
    """
    reach = max(1, int(np.ceil(np.abs(way).max() / 2)))
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    for part in np.linspace(-0.5, 0.5, 48 * reach):
        x, y = np.floor(way * part + 0.5).astype(int) + reach
        kernel[y, x] += 1
    return np.asarray(kernel / kernel.sum(), np.float32)


def chosen(pieces: Pieces, rng: np.random.Generator) -> tuple[int, int]:
    """Rows of a pair; balls are one object in twenty, and are drawn more often than that."""
    rows = np.arange(len(pieces.pairs))
    if rng.random() < SMALL:
        small = np.flatnonzero(pieces.scales[pieces.pairs[:, 0]] * SMALL_PX > PIECE_PX / ACROSS)
        rows = small if len(small) else rows
    first, second = pieces.pairs[int(rng.choice(rows))]
    return int(first), int(second)


def pasted_pair(pieces: Pieces, rng: np.random.Generator) -> tuple[Scene, Scene]:
    """Something on two grounds, in the second one with others beside it in half of the cases."""
    patch, mask = thing(pieces, rng)
    sides = 32 * np.exp(rng.normal(0, 0.25) * np.array([-1, 1]))
    found = []
    for second in (False, True):
        under = shifted(scene_of(pieces, int(rng.integers(len(pieces.pictures)))), rng)
        change = np.exp(rng.normal(0, 0.12)) if second else 1.0
        middle = np.full(2, PIECE_PX / 2, np.float32)
        box = from_centres(middle, (sides * change).astype(np.float32))
        if second and rng.random() < 0.5:
            other, form = thing(pieces, rng)
            turn = rng.uniform(0, 2 * np.pi)
            away = rng.uniform(1.0, 2.0) * 32 * np.array([np.cos(turn), np.sin(turn)])
            beside = box + np.tile(away, 2).astype(np.float32)
            under = Scene(picture=pasted(under, other, form, beside), box=beside, scale=under.scale)
        picture = pasted(under, patch, mask, box)
        found.append(Scene(picture=picture, box=box.round(), scale=under.scale))
    return found[0], found[1]


def drawn(pieces: Pieces, rng: np.random.Generator) -> tuple[Scene, Scene, bool]:
    """The scenes of a template and of a search picture, and whether both show the object."""
    draw = rng.random()
    first, second = chosen(pieces, rng)
    if draw < ABSENT:
        other = int(rng.integers(len(pieces.pictures)))
        same = other in (first, second)
        return scene_of(pieces, first), changed(scene_of(pieces, other), rng), bool(same)
    if draw < ABSENT + PASTED:
        before, now = pasted_pair(pieces, rng)
        return before, changed(now, rng), True
    if first == second:
        return scene_of(pieces, first), changed(scene_of(pieces, first), rng), True
    if rng.random() < 0.5:
        first, second = second, first
    return scene_of(pieces, first), scene_of(pieces, second), True


def sample(pieces: Pieces, rng: np.random.Generator) -> tuple[Picture, Box, Picture, Box, bool]:
    """Template, its shape, search picture, box in it (pixels) and whether the object is there."""
    before, now, there = drawn(pieces, rng)
    jitter = rng.normal(0, 0.04, 2) * size_of(before.box)
    side = TEMPLATE_FACTOR * size_of(before.box) * np.exp(rng.normal(0, 0.04))
    middle = (centres(before.box) + jitter).astype(np.float32)
    template = streams_of(before, rng).look(middle, side, TEMPLATE_PX).copy()
    size = size_of(now.box)
    reach = SHIFT if rng.random() < 0.5 else SHIFT / 3
    middle = (centres(now.box) + rng.uniform(-reach, reach, 2) * size).astype(np.float32)
    side = SEARCH_FACTOR * size * np.exp(np.clip(rng.normal(0, 0.15), -0.4, 0.4))
    search = streams_of(now, rng).look(middle, side, SEARCH_PX).copy()
    box = (now.box - np.tile(middle - side / 2, 2)) * np.float32(SEARCH_PX / side)
    if rng.random() < 0.5:
        template, search = template[:, ::-1], search[:, ::-1]
        box = np.array([SEARCH_PX - box[2], box[1], SEARCH_PX - box[0], box[3]], np.float32)
    light = int(rng.integers(2**31))
    template = recolour(np.ascontiguousarray(template), np.random.default_rng(light))
    search = recolour(np.ascontiguousarray(search), np.random.default_rng(light))
    shape = shape_of(before.box)
    return degrade(template, rng), shape, degrade(search, rng), box.astype(np.float32), there


def batch(pieces: Pieces, count: int, rng: np.random.Generator) -> Arrays:
    """Samples as a training takes them; heat (n, 16, 16), near (n, 16, 16), place (n, 4, 16, 16).

    Pictures are (n, 3, h, w) of 8 bit, which take a quarter of the way to a GPU. `place` is log
    width and height against a quarter of the picture, and the offset in cells.
    """
    out: Arrays = {
        "template": np.empty((count, 3, TEMPLATE_PX, TEMPLATE_PX), np.uint8),
        "shape": np.empty((count, 2), np.float32),
        "search": np.empty((count, 3, SEARCH_PX, SEARCH_PX), np.uint8),
        "there": np.zeros((count, 1), np.float32),
        "heat": np.zeros((count, CELLS, CELLS), np.float32),
        "near": np.zeros((count, CELLS, CELLS), np.float32),
        "place": np.zeros((count, 4, CELLS, CELLS), np.float32),
    }
    for k in range(count):
        template, shape, search, box, there = sample(pieces, rng)
        out["template"][k] = template.transpose(2, 0, 1)
        out["search"][k] = search.transpose(2, 0, 1)
        out["shape"][k] = shape
        if there:
            out["there"][k] = 1
            out["heat"][k], out["near"][k], out["place"][k] = targets(box)
    return out


def targets(box: Box) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """What the maps should be for a box in a search picture: heat, near, place.

    >>> heat, near, place = targets(np.array([52, 44, 84, 76], np.float32))
    >>> [int(k) for k in np.unravel_index(heat.argmax(), heat.shape)], place[:, 7, 8].tolist()
    ([7, 8], [0.0, 0.0, 0.0, 0.0])
    """
    centre = centres(box) * CELLS / SEARCH_PX
    cells = np.arange(CELLS, dtype=np.float32) + 0.5
    apart_x, apart_y = np.broadcast_arrays(centre[0] - cells[None, :], centre[1] - cells[:, None])
    heat = np.exp(-(apart_x**2 + apart_y**2) / (2 * 0.8**2))
    column, row = np.clip(centre.astype(int), 0, CELLS - 1)
    heat[row, column] = 1
    near = (np.maximum(np.abs(apart_x), np.abs(apart_y)) <= NEAR).astype(np.float32)
    sizes = np.log(np.maximum(box[2:] - box[:2], 1) * SEARCH_FACTOR / SEARCH_PX)
    maps = np.ones((2, CELLS, CELLS), np.float32) * sizes[:, None, None]
    place = np.concatenate([maps, np.stack([apart_x, apart_y])])
    return heat.astype(np.float32), near, place.astype(np.float32)
