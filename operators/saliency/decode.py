"""A detector's raw output -> candidates: boxes, angles, scores and classes, in input pixels.

Five kinds of output are understood:
- `yolo`  (1, 4 + classes, anchors): centre x, y, width, height in pixels, then class scores 0..1;
- `obb`   the same with one more row, the angle in radians;
- `yolox` (1, anchors, 5 + classes): Ge et al., "YOLOX" (2021): offsets in cells, log sizes,
  objectness and class scores 0..1, anchors row by row over strides 8, 16 and 32;
- `yolox_decoded` the same with centre and size in pixels (`--decode_in_inference` of its export);
- `end2end` (1, n, 6), suppressed in the network (YOLOv10, YOLO26, `nms=True`): corners in pixels,
  score, class; or (1, n, 7) of turned boxes: centre, size, score, class, angle. A row of score 0 is
  empty.

A score that is no number passes every threshold: `usable` tells it, so that somebody hears of it.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline import MessageError, WeightsError
from pipeline.boxes import iou

Array = NDArray[np.float32]
Kind = Literal["yolo", "obb", "yolox", "yolox_decoded", "end2end"]
YOLOX_STRIDES = (8, 16, 32)
CANDIDATES = 300  # best ones that reach suppression, whose cost grows with their square
FARTHEST_PX = 1e6  # a coordinate of what may be a box; YOLOX's largest, e^10 cells, stay within
SCORE_SLACK = 0.01  # above 1, by the rounding of quantised networks


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """Found objects, best first. A turned box lies around the same centre as its upright one."""

    boxes: Array  # (n, 4) xyxy, pixels of the network's input, before turning
    angles: Array  # (n,) radians
    scores: Array  # (n,) 0..1
    classes: NDArray[np.intp]  # (n,) row of the class in the output

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> "Candidates":
        """The named rows, in that order, or those of a mask."""
        return Candidates(
            boxes=self.boxes[rows],
            angles=self.angles[rows],
            scores=self.scores[rows],
            classes=self.classes[rows],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """Cells of a YOLOX output: top left corner in cells and stride of each anchor."""

    cells: Array  # (anchors, 2) x, y
    strides: Array  # (anchors, 1) pixels


def yolox_grid(width_px: int, height_px: int) -> Grid:
    """All anchors of an input of this size.

    >>> yolox_grid(416, 416).cells.shape
    (3549, 2)
    """
    cells, steps = [], []
    for stride in YOLOX_STRIDES:
        rows, columns = height_px // stride, width_px // stride
        y, x = np.mgrid[:rows, :columns].reshape(2, -1)
        cells.append(np.stack([x, y], 1))
        steps.append(np.full((rows * columns, 1), stride))
    return Grid(
        cells=np.concatenate(cells).astype(np.float32),
        strides=np.concatenate(steps).astype(np.float32),
    )


def kind_of(shape: tuple[int, ...], size_px: tuple[int, int], task: str = "") -> Kind:
    """Tell the kind by the output's shape, the input's width and height, and the metadata's task.

    `task` is "" without metadata. Raises `WeightsError` for a shape that is of no kind; a decoded
    YOLOX output looks like any other.

    >>> kind_of((1, 84, 8400), (640, 640)), kind_of((1, 300, 6), (640, 640))
    ('yolo', 'end2end')
    """
    if fits(shape, "yolox", size_px) and not task:
        return "yolox"
    if len(shape) == 3 and shape[1] < shape[2] and fits(shape, "yolo", size_px):
        return "obb" if task == "obb" else "yolo"
    if fits(shape, "end2end", size_px):
        return "end2end"
    width_px, height_px = size_px
    raise WeightsError(
        "expected an output (1, 4 + classes, anchors), (1, n, 6) or "
        f"(1, {anchors_of(size_px)}, 5 + classes) for a {width_px}x{height_px} input, got {shape}"
    )


def fits(shape: tuple[int, ...], kind: Kind, size_px: tuple[int, int]) -> bool:
    """Whether an output of this shape can be of that kind."""
    if len(shape) != 3 or shape[0] != 1:
        return False
    if kind == "end2end":
        return shape[2] in (6, 7)
    if kind in ("yolox", "yolox_decoded"):
        return shape[1] == anchors_of(size_px) and shape[2] > 5
    return shape[1] > (5 if kind == "obb" else 4)


def anchors_of(size_px: tuple[int, int]) -> int:
    """Number of YOLOX's anchors for an input of this width and height."""
    return sum((size_px[0] // stride) * (size_px[1] // stride) for stride in YOLOX_STRIDES)


def class_count(shape: tuple[int, ...], kind: Kind) -> int:
    """Number of classes in an output of this shape; 0 for one that does not tell."""
    if kind == "end2end":
        return 0
    return {"yolo": shape[1] - 4, "obb": shape[1] - 5}.get(kind, shape[2] - 5)


def decode_yolo(output: Array, thresholds: Array, *, turned: bool = False) -> Candidates:
    """Candidates above their class's threshold, best first, at most `CANDIDATES`.

    `output` (4 + classes [+ 1], anchors); `thresholds` (classes,), above 1 to leave a class out.
    """
    scores = output[4 : 4 + len(thresholds)]
    anchors = np.flatnonzero(~(scores < thresholds[:, None]).all(0))
    found = scores[:, anchors]
    kept = _best(np.where(found < thresholds[:, None], 0, found), output[:4, anchors].T)
    if not turned:
        return kept[0]
    candidates, rows = kept
    return replace(candidates, angles=output[4 + len(thresholds), anchors[rows]])


def decode_yolox(output: Array, thresholds: Array, grid: Grid | None) -> Candidates:
    """Candidates of an (anchors, 5 + classes) output above their class's threshold, best first.

    Without a grid, centres and sizes are in pixels already.
    """
    objectness = output[:, 4]
    # the product of both is at most the objectness: most anchors need no further look
    likely = np.flatnonzero(~(objectness < thresholds.min()))
    scores = output[likely, 5:] * objectness[likely, None]
    passed = ~(scores < thresholds).all(1)
    anchors, scores = likely[passed], scores[passed]
    raw = output[anchors, :4]
    if grid is None:
        return _best(np.where(scores < thresholds, 0, scores).T, raw)[0]
    strides = grid.strides[anchors]
    centres = (raw[:, :2] + grid.cells[anchors]) * strides
    # a wild log size must not overflow: no box is larger than e^10 cells
    sizes = np.exp(np.minimum(raw[:, 2:], 10)) * strides
    return _best(np.where(scores < thresholds, 0, scores).T, np.hstack([centres, sizes]))[0]


def decode_end2end(output: Array, thresholds: Array) -> Candidates:
    """Candidates of an (n, 6) or (n, 7) output above their class's threshold, best first.

    Raises `MessageError` for a class that `thresholds` (classes,) does not have.
    """
    found = output[~(output[:, 4] <= 0)]
    found[np.isnan(found[:, 4]), 5] = 0  # any class: the row is not usable
    classes = found[:, 5]
    known = (classes >= 0) & (classes < len(thresholds)) & (classes == np.trunc(classes))
    if len(wrong := classes[~known]):
        raise MessageError(
            f"saliency: expected classes 0 to {len(thresholds) - 1}, as many as the detector has "
            f"names, got {wrong[0]:g}"
        )
    found = found[~(found[:, 4] < thresholds[classes.astype(np.intp)])]
    found = found[np.argsort(-found[:, 4], kind="stable")[:CANDIDATES]]
    boxes, turned = found[:, :4], output.shape[1] == 7
    if turned:
        boxes = np.hstack([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2])
    return Candidates(
        boxes=boxes.astype(np.float32),
        angles=found[:, 6] if turned else np.zeros(len(found), np.float32),
        scores=found[:, 4],
        classes=found[:, 5].astype(np.intp),
    )


def _best(scores: Array, centred: Array) -> tuple[Candidates, NDArray[np.intp]]:
    """Class and order of candidates: (classes, n) scores, (n, 4) centre and size."""
    if not scores.size:
        scores = np.zeros((1, 0), np.float32)
    classes = scores.argmax(0)
    best = scores[classes, np.arange(scores.shape[1])]
    rows = np.argsort(-best, kind="stable")[:CANDIDATES]
    half = centred[rows, 2:] / 2
    boxes = np.hstack([centred[rows, :2] - half, centred[rows, :2] + half])
    found = Candidates(
        boxes=boxes.astype(np.float32),
        angles=np.zeros(len(rows), np.float32),
        scores=best[rows].astype(np.float32),
        classes=classes[rows],
    )
    return found, rows


def usable(found: Candidates) -> NDArray[np.bool_]:
    """Whether each has a finite box of some area, a finite angle and a score 0..1: (n,)."""
    boxes, scores = found.boxes, found.scores
    # a comparison with what is no number is false
    within = (np.abs(boxes) <= FARTHEST_PX).all(1) & (boxes[:, 2:] > boxes[:, :2]).all(1)
    score = (scores >= 0) & (scores <= 1 + SCORE_SLACK)
    return np.asarray(within & score & np.isfinite(found.angles))


def suppress(candidates: Candidates, limit_iou: float, *, agnostic: bool) -> NDArray[np.intp]:
    """Rows that remain after greedy non-maximum suppression, best first.

    A row falls when a better one of its class (of any class if `agnostic`) overlaps it by more
    than `limit_iou`.
    """
    if not len(candidates.scores):
        return np.zeros(0, np.intp)
    same = np.ones((len(candidates.scores),) * 2, np.bool_)
    if not agnostic:
        same = candidates.classes[:, None] == candidates.classes[None]
    turned = bool(candidates.angles.any())
    overlap = _turned_iou(candidates) if turned else iou(candidates.boxes, candidates.boxes)
    rival = (overlap > limit_iou) & same
    rest, kept = np.arange(len(rival)), []
    while len(rest):
        kept.append(rest[0])
        rest = rest[1:][~rival[rest[0], rest[1:]]]
    return np.array(kept, np.intp)


def _turned_iou(candidates: Candidates) -> Array:
    """Intersection over union of every pair of turned boxes: (n, n)."""
    low, high = candidates.boxes[:, :2], candidates.boxes[:, 2:]
    centres, sizes = (low + high) / 2, np.maximum(high - low, 0)
    turns = np.degrees(candidates.angles)
    shapes = [
        ((float(c[0]), float(c[1])), (float(s[0]), float(s[1])), float(t))
        for c, s, t in zip(centres, sizes, turns, strict=True)
    ]
    areas = sizes[:, 0] * sizes[:, 1]
    reach = np.linalg.norm(sizes, axis=1) / 2
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    near = np.argwhere(np.triu(distance < reach[:, None] + reach[None], 1))
    overlap = np.zeros((len(areas), len(areas)), np.float32)
    for i, j in near:
        _, corners = cv2.rotatedRectangleIntersection(shapes[i], shapes[j])
        if corners is not None and len(corners) > 2:
            common = cv2.contourArea(cv2.convexHull(corners))
            overlap[i, j] = overlap[j, i] = common / max(areas[i] + areas[j] - common, 1e-9)
    return overlap
