"""Appearance of objects from a feature map: (C, h, w) and boxes -> (n, C).

RoIAlign of He et al., "Mask R-CNN" (2017), section 3: bilinear samples at fixed points of each
box, nothing rounded; here averaged over the box, so that a box gives one vector.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]


def roi_align(features: Array, boxes: Array, *, stride_px: int, grid: int = 3) -> Array:
    """Mean of `grid` x `grid` bilinear samples in each box.

    `features` (C, h, w); `boxes` (n, 4) xyxy in pixels of the network's input, of which a cell of
    the map covers `stride_px`; cell centres lie at (i + 0.5) * stride. -> (n, C), 0 rows for none.

    >>> ramp = np.arange(4, dtype=np.float32)[None, None, :].repeat(2, 1)
    >>> roi_align(ramp, np.array([[8, 0, 16, 16]], np.float32), stride_px=8).tolist()
    [[1.0]]
    """
    channels, height, width = features.shape
    if not len(boxes):
        return np.zeros((0, channels), np.float32)
    steps = ((np.arange(grid) + 0.5) / grid).astype(np.float32)
    low, size = boxes[:, :2, None], (boxes[:, 2:] - boxes[:, :2])[:, :, None]
    points = ((low + size * steps) / stride_px - 0.5).astype(np.float32)  # (n, 2, grid), cells
    x0, x1, right = _between(points[:, 0], width)
    y0, y1, below = _between(points[:, 1], height)
    flat = features.reshape(channels, height * width)
    total = np.zeros((channels, len(boxes)), np.float32)
    for rows, weight_y in ((y0, 1 - below), (y1, below)):
        for columns, weight_x in ((x0, 1 - right), (x1, right)):
            cells = rows[:, :, None] * width + columns[:, None, :]  # (n, grid, grid)
            weight = weight_y[:, :, None] * weight_x[:, None, :]
            total += np.einsum("cnij,nij->cn", flat[:, cells], weight)
    return np.ascontiguousarray(total.T) / np.float32(grid * grid)


def _between(
    points: Array, size: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """The cells on both sides of each point and the share of the second, clamped to the map."""
    points = np.clip(points, 0, size - 1)
    first = np.floor(points).astype(np.intp)
    return first, np.minimum(first + 1, size - 1), points - first.astype(np.float32)
