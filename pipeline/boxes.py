"""Box arithmetic: (n, 4) arrays of `xyxy` boxes in, numbers or boxes out."""

import numpy as np
from numpy.typing import NDArray

from pipeline.messages import Frame, Geometry, Tracks

Array = NDArray[np.float32]
MOST_PAIRS = 2**17  # compared at once, so that temporary arrays stay in the cache


def areas(boxes: Array) -> Array:
    """Area of each box, 0 for an empty one: (n, 4) -> (n,), square pixels.

    >>> areas(np.array([[0, 0, 2, 3], [5, 5, 4, 9]], np.float32)).tolist()
    [6.0, 0.0]
    """
    sides = np.maximum(boxes[..., 2:] - boxes[..., :2], 0)
    return np.asarray(sides[..., 0] * sides[..., 1], np.float32)


def sizes(boxes: Array) -> Array:
    """Square root of the area of each box: (n, 4) -> (n,), pixels, at least 1."""
    return np.asarray(np.maximum(np.sqrt(areas(boxes)), 1), np.float32)


def intersections(a: Array, b: Array) -> Array:
    """Area of the intersection of every pair: (n, 4), (m, 4) -> (n, m), square pixels."""
    # one axis at a time: an innermost axis of length two takes four times as long
    wide = np.minimum(a[:, None, 2], b[:, 2]) - np.maximum(a[:, None, 0], b[:, 0])
    high = np.minimum(a[:, None, 3], b[:, 3]) - np.maximum(a[:, None, 1], b[:, 1])
    return np.asarray(np.maximum(wide, 0) * np.maximum(high, 0), np.float32)


def in_parts(boxes: Array, others: int) -> list[Array]:
    """Return boxes (n, 4) in parts that may be compared with so many others at once.

    >>> [len(part) for part in in_parts(np.zeros((900, 4), np.float32), 300)]
    [300, 300, 300]
    """
    return np.array_split(boxes, max(1, -(-len(boxes) * others // MOST_PAIRS)))


def iou(a: Array, b: Array) -> Array:
    """Intersection over union of every pair: (n, 4), (m, 4) -> (n, m), 0..1.

    >>> iou(np.array([[0, 0, 2, 2]], np.float32), np.array([[1, 0, 3, 2]], np.float32)).round(3)
    array([[0.333]], dtype=float32)
    """
    common = intersections(a, b)
    union = areas(a)[:, None] + areas(b)[None, :] - common
    return np.asarray(common / np.maximum(union, 1e-9), np.float32)


def covered(boxes: Array, window: Array) -> Array:
    """Fraction of each box inside a window: (n, 4), (4,) -> (n,), 0..1; 0 for empty boxes."""
    common = intersections(boxes, np.asarray(window, np.float32)[None])[:, 0]
    return np.asarray(common / np.maximum(areas(boxes), 1e-9), np.float32)


def outside(boxes: Array, window: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the parts of boxes outside a window: (n, 4), (4,) -> disjoint (m, 4), their rows (m,).

    Each box leaves at most four parts: above, below, left and right of the window.

    >>> outside(np.array([[0, 0, 4, 4]], np.float32), np.array([2, 0, 9, 9]))[0].tolist()
    [[0.0, 0.0, 2.0, 4.0]]
    """
    x0, y0, x1, y1 = np.asarray(boxes, np.float32).T
    left, top, right, bottom = (np.float32(side) for side in window)
    above, below = np.clip(top, y0, y1), np.clip(bottom, y0, y1)
    before, after = np.clip(left, x0, x1), np.clip(right, x0, x1)
    parts = np.stack([
        np.stack([x0, y0, x1, above], -1),
        np.stack([x0, below, x1, y1], -1),
        np.stack([x0, above, before, below], -1),
        np.stack([after, above, x1, below], -1),
    ])  # fmt: skip
    place, rows = np.nonzero(areas(parts) > 0)
    return parts[place, rows], rows


def covered_by(boxes: Array, windows: Array) -> Array:
    """Fraction of each box inside any of several windows: (n, 4), (k, 4) -> (n,), 0..1.

    >>> two = np.array([[0, 0, 2, 2], [1, 0, 3, 2]], np.float32)
    >>> covered_by(np.array([[0, 0, 4, 2]], np.float32), two).tolist()
    [0.75]
    """
    left, rows = np.asarray(boxes, np.float32), np.arange(len(boxes))
    for window in windows:
        left, parents = outside(left, window)
        rows = rows[parents]
    missing = np.bincount(rows, areas(left), len(boxes))
    whole = areas(boxes)
    return np.asarray(np.where(whole > 0, 1 - missing / np.maximum(whole, 1e-9), 0), np.float32)


def centres(boxes: Array) -> Array:
    """Centre of each box: (..., 4) -> (..., 2), (x, y)."""
    return np.asarray((boxes[..., :2] + boxes[..., 2:]) / 2, np.float32)


def from_centres(centre: Array, size: Array) -> Array:
    """Boxes from centres (..., 2) and (width, height) (..., 2) -> (..., 4)."""
    half = np.asarray(size, np.float32) / 2
    return np.concatenate([centre - half, centre + half], -1).astype(np.float32)


def parts_of(boxes: Array, part: tuple[float, float, float, float]) -> Array:
    """Return a part of each box (n, 4): its left, top, right and low as shares of the sides.

    >>> parts_of(np.array([[0, 0, 10, 20]], np.float32), (0.1, 0.5, 0.9, 1)).tolist()
    [[1.0, 10.0, 9.0, 20.0]]
    """
    sides = boxes[:, 2:] - boxes[:, :2]
    found = np.tile(boxes[:, :2], 2) + np.tile(sides, 2) * np.array(part)
    return np.asarray(found, np.float32)


def in_picture(boxes: Array, frame: Frame) -> Array:
    """Return boxes (n, 4), or one (4,), in sensor pixels as pixels of a picture of a window."""
    left, top, right, low = frame.window
    height, width = frame.pixels.shape[:2]
    scale = np.array([width / (right - left), height / (low - top)] * 2)
    return np.asarray((boxes - (left, top, left, top)) * scale, np.float32)


def boxes_at(tracks: Tracks, seq: int) -> Array | None:
    """Return the boxes (n, 4) of tracks in a frame, sensor pixels; None before their history.

    Of a later frame they are foreseen, at most as far as the tracks foresee.
    """
    ahead = min(seq - tracks.header.seq, tracks.predicted.shape[1])
    if ahead > 0:
        return tracks.predicted[:, ahead - 1]
    return tracks.boxes[:, ahead - 1] if -ahead < tracks.boxes.shape[1] else None


def roi_window(centre: Array, geometry: Geometry) -> tuple[int, int, int, int]:
    """Return the ROI window nearest to `centre` (x, y): inside the field, aligned to `step_px`.

    >>> g = Geometry(width_px=100, height_px=60, roi_width_px=20, roi_height_px=10, step_px=4)
    >>> roi_window(np.array([97.0, 30.0], np.float32), g)
    (80, 24, 100, 34)
    """
    left = _start(float(centre[0]), geometry.width_px, geometry.roi_width_px, geometry)
    top = _start(float(centre[1]), geometry.height_px, geometry.roi_height_px, geometry)
    return left, top, left + geometry.roi_width_px, top + geometry.roi_height_px


def _start(centre: float, field_px: int, side_px: int, geometry: Geometry) -> int:
    free = round(centre - side_px / 2)
    return geometry.aligned(max(0, min(free, field_px - side_px)))
