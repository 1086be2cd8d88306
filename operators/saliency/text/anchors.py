"""Which anchors of the text detector may find which word: turned boxes -> numbers of anchors."""

import numpy as np
from numpy.typing import NDArray

ANCHOR_PX = (4.0, 2.0)  # width, height of an anchor's own part of the picture
MOST = 16  # anchors that may find one word
REACH_PX = (2.6, 1.4)  # half sides of the least place whose anchors may find a word
BORDER_PX = 1.0  # around what may be found or not

Floats = NDArray[np.float32]


def centres(width_px: int, height_px: int) -> Floats:
    """Centres of all anchors of an input, row by row: (A, 2).

    >>> len(centres(320, 192))
    7680
    """
    across, down = (int(s / a) for s, a in zip((width_px, height_px), ANCHOR_PX, strict=True))
    y, x = np.mgrid[:down, :across]
    cells = np.stack([x, y], 2).reshape(-1, 2) + 0.5
    return (cells * ANCHOR_PX).astype(np.float32)


def inside(boxes: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Distances of points (A, 2) from the axes of boxes (n, 5): along and across, each (n, A)."""
    away = points[None] - boxes[:, None, :2]
    sine, cosine = np.sin(boxes[:, 4, None]), np.cos(boxes[:, 4, None])
    along = np.abs(away[..., 0] * cosine + away[..., 1] * sine)
    across = np.abs(away[..., 1] * cosine - away[..., 0] * sine)
    return along, across


def candidates(boxes: Floats, points: Floats) -> NDArray[np.int64]:
    """Anchors in the middle of each box, nearest first, -1 past them: (n, MOST)."""
    chosen = np.full((len(boxes), MOST), -1, np.int64)
    if not len(boxes):
        return chosen
    along, across = inside(boxes, points)
    half = boxes[:, 2:4] / 2
    limit_x = np.maximum(half[:, :1] * 0.6, REACH_PX[0])
    limit_y = np.maximum(half[:, 1:] * 0.7, REACH_PX[1])
    far = np.hypot(along / limit_x, across / limit_y)
    far[(along > limit_x) | (across > limit_y)] = np.inf
    order = np.argpartition(far, MOST, 1)[:, :MOST]
    near = np.take_along_axis(far, order, 1)
    return np.where(np.isfinite(near), order, -1)


def uncounted(boxes: Floats, points: Floats) -> NDArray[np.bool_]:
    """Which points lie on one of the boxes, which may be found or not: (A,)."""
    if not len(boxes):
        return np.zeros(len(points), np.bool_)
    along, across = inside(boxes, points)
    half = boxes[:, 2:4] / 2 + BORDER_PX
    covered = (along <= half[:, :1]) & (across <= half[:, 1:])
    return np.asarray(covered.any(0), np.bool_)
