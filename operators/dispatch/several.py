"""The best few windows for one frame: objects with weights in, windows out.

The value of a set of windows is the sum, over objects, of weight times the share of the object's
box inside any of them: what two windows show counts once. This is monotone and submodular, so
taking the window of the greatest further gain again and again reaches at least 1 - 1/e of the best
set (Nemhauser, Wolsey and Fisher, 1978). Each of these windows is the best one of all that the
sensor can address: the gain is piecewise linear along each axis, so it is greatest where an edge of
a window meets an edge of what is not shown yet.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.boxes import areas, centres, from_centres, outside, roi_window
from pipeline.messages import Geometry, Scanpath, Tracks

SAME = 1e-6  # of all weights: gains that differ by less are equal
FAR_PX = 2.0**24  # beyond any field, but sums stay exact in float32
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Objects:
    """What one frame may show; n may be 0."""

    boxes: NDArray[np.float32]  # (n, 4), sensor pixels
    weights: NDArray[np.float32]  # (n,), at least 0


def expected(scanpath: Scanpath, row: int, tracks: Tracks | None, others: float) -> Objects:
    """Return the objects of a scanpath's row: weight is probability, `others` more for each track.

    The scanpath has the box of its choice only; those of the other objects are predictions of
    `tracks`, found by id. A choice of a position gets the probability that no object has.
    """
    chosen, box = int(scanpath.choice[row]), scanpath.boxes[row]
    believed = dict(zip(scanpath.ids.tolist(), scanpath.probability[row].tolist(), strict=True))
    boxes: dict[int, NDArray[np.float32]] = {}
    if tracks is not None and tracks.predicted.shape[1]:
        ahead = scanpath.first_seq + row - tracks.header.seq - 1
        column = min(max(ahead, 0), tracks.predicted.shape[1] - 1)
        boxes = dict(zip(tracks.ids.tolist(), tracks.predicted[:, column], strict=True))
    weights = {i: believed.get(i, 0.0) + others for i in boxes}
    if is_box(box):
        left = 1 - sum(believed.values())
        usual = believed.get(chosen, left) if chosen >= 0 else left
        boxes[chosen] = box
        weights[chosen] = max(usual, 0.0) + (others if chosen >= 0 else 0.0)
    rows = [i for i in boxes if is_box(boxes[i]) and 0 < weights[i] < np.inf]
    return Objects(
        boxes=np.array([boxes[i] for i in rows], np.float32).reshape(-1, 4),
        weights=np.array([weights[i] for i in rows], np.float32),
    )


def is_box(box: NDArray[np.float32]) -> bool:
    """Whether a row (4,) is a box with area."""
    return bool(np.isfinite(box).all() and box[2] > box[0] and box[3] > box[1])


def grown(boxes: NDArray[np.float32], margin: float, geometry: Geometry) -> NDArray[np.float32]:
    """Boxes (n, 4) with `margin` sides more on each side, cut to the field."""
    near = np.clip(boxes, -FAR_PX, FAR_PX)
    wide = from_centres(centres(near), (near[:, 2:] - near[:, :2]) * (1 + 2 * margin))
    field = np.array([geometry.width_px, geometry.height_px] * 2, np.float32)
    return np.clip(wide, 0, field)


def best_windows(
    objects: Objects, geometry: Geometry, count: int, *, least_gain: float = 0.0
) -> NDArray[np.int32]:
    """Up to `count` windows (k, 4), greedily; fewer where the next would gain nothing.

    A window gains nothing below `least_gain`, in units of weight. Of equal gains a window around
    the object of the greatest weight wins, else the one nearest to the middle of what it shows.
    """
    whole = areas(objects.boxes)
    parts, rows = objects.boxes[whole > 0], np.flatnonzero(whole > 0)
    density = np.divide(objects.weights, whole, where=whole > 0, out=np.zeros_like(whole))
    tolerance = SAME * float(objects.weights.sum())
    usual = _centred(objects, geometry)
    found: list[tuple[int, int, int, int]] = []
    while len(found) < count and len(parts):
        window, gain = _best(parts, density[rows], usual, geometry, tolerance)
        if gain <= max(tolerance, least_gain):
            break
        found.append(window)
        parts, kept = outside(parts, np.array(window, np.float32))
        rows = rows[kept]
    return np.array(found, np.int32).reshape(-1, 4)


def _centred(objects: Objects, geometry: Geometry) -> NDArray[np.int32]:
    """Corners (n, 2) of the windows around each object, greatest weight first."""
    order = np.argsort(-objects.weights, kind="stable")
    corners = [roi_window(centres(objects.boxes[i]), geometry)[:2] for i in order]
    return np.array(corners, np.int32).reshape(-1, 2)


def _best(
    parts: NDArray[np.float32],
    density: NDArray[np.float32],
    usual: NDArray[np.int32],
    geometry: Geometry,
    tolerance: float,
) -> tuple[tuple[int, int, int, int], float]:
    """The window of the greatest gain, and its gain, for disjoint parts (m, 4) of objects."""
    size = (geometry.roi_width_px, geometry.roi_height_px)
    field = (geometry.width_px, geometry.height_px)
    boxes = parts.astype(np.float64)
    starts, overlaps = [], []
    for axis in (0, 1):
        low, high = boxes[:, axis], boxes[:, axis + 2]
        most = geometry.aligned(field[axis] - size[axis])
        start = _starts(low, high, usual[:, axis], size[axis], most, geometry.step_px)
        starts.append(start)
        overlaps.append(_overlaps(start, low, high, size[axis]))
    gains = (overlaps[0] * density) @ overlaps[1].T  # (x, y)
    gain = float(gains.max())
    left, top = _preferred(gains >= gain - tolerance, starts, usual, boxes, density, size)
    return (left, top, left + size[0], top + size[1]), gain


def _starts(
    low: Floats, high: Floats, usual: NDArray[np.int32], side: int, most: int, step: int
) -> NDArray[np.int32]:
    """Candidates along one axis, ascending: where a window begins or ends with a part.

    Of both neighbours on the sensor's grid one is the best that it can address.
    """
    edges = np.concatenate([low, high - side]) // step * step
    found = np.concatenate([edges, edges + step, usual])
    return np.unique(np.clip(found, 0, most)).astype(np.int32)


def _overlaps(start: NDArray[np.int32], low: Floats, high: Floats, side: int) -> Floats:
    """Length shared by windows (s,) and parts (m,) along one axis: (s, m)."""
    begin, end = np.maximum(start[:, None], low), np.minimum(start[:, None] + side, high)
    return np.asarray(np.maximum(end - begin, 0))


def _preferred(
    best: NDArray[np.bool_],
    starts: list[NDArray[np.int32]],
    usual: NDArray[np.int32],
    boxes: Floats,
    density: NDArray[np.float32],
    size: tuple[int, int],
) -> tuple[int, int]:
    """The corner to take among equally good ones, `best` (x, y)."""
    x, y = starts
    columns, rows = np.searchsorted(x, usual[:, 0]), np.searchsorted(y, usual[:, 1])
    centred = np.flatnonzero(best[columns, rows])
    if len(centred):
        return int(usual[centred[0], 0]), int(usual[centred[0], 1])
    at = np.argwhere(best)
    corners = np.stack([x[at[:, 0]], y[at[:, 1]]], -1)
    first = corners[0]
    shown = np.maximum(
        np.minimum(boxes[:, 2:], first + size) - np.maximum(boxes[:, :2], first), 0
    ).prod(-1)
    middle = np.average((boxes[:, :2] + boxes[:, 2:]) / 2, axis=0, weights=shown * density)
    nearest = np.abs(corners + np.array(size) / 2 - middle).sum(-1).argmin()
    return int(corners[nearest, 0]), int(corners[nearest, 1])
