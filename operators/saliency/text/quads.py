"""Words as four corners, as turned boxes and as upright boxes.

Corners go clockwise on the screen from where the word begins: (n, 4, 2) x, y in pixels. A turned
box is (n, 5): centre x, y, length along the word, height, angle in radians.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def turned(quads: Floats) -> Floats:
    """Return the turned box of each quadrilateral: same centre and area, along its long edges.

    The angle is within -90 to 90 degrees: a word upside down looks like one.

    >>> turned(np.array([[[0, 0], [8, 0], [8, 2], [0, 2]]], np.float32)).tolist()
    [[4.0, 1.0, 8.0, 2.0, 0.0]]
    """
    top, bottom = quads[:, 1] - quads[:, 0], quads[:, 2] - quads[:, 3]
    along = (top + bottom) / 2
    length = np.linalg.norm(along, axis=1)
    height = areas(quads) / np.maximum(length, 1e-6)
    angle = np.arctan2(along[:, 1], along[:, 0])
    angle = (angle + np.pi / 2) % np.pi - np.pi / 2
    parts = [quads.mean(1), length[:, None], height[:, None], angle[:, None]]
    return np.concatenate(parts, 1).astype(np.float32)


def corners(boxes: Floats) -> Floats:
    """Return the corners of turned boxes (n, 5): (n, 4, 2)."""
    half = boxes[:, None, 2:4] / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    sine, cosine = np.sin(boxes[:, 4]), np.cos(boxes[:, 4])
    turn = np.stack([np.stack([cosine, sine], 1), np.stack([-sine, cosine], 1)], 1)
    return np.asarray(half @ turn + boxes[:, None, :2], np.float32)


def upright(quads: Floats) -> Floats:
    """Return the upright xyxy box around each quadrilateral: (n, 4)."""
    return np.concatenate([quads.min(1), quads.max(1)], 1).astype(np.float32)


def areas(quads: Floats) -> Floats:
    """Return the areas of quadrilaterals: (n,)."""
    across, down = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    return np.asarray(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]) / 2, np.float32)


def polygon_iou(a: Floats, b: Floats) -> Floats:
    """Return intersection over union of convex quadrilaterals (n, 4, 2), (m, 4, 2): (n, m)."""
    overlap = np.zeros((len(a), len(b)), np.float32)
    first, second, sizes = upright(a), upright(b), (areas(a), areas(b))
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    for i, j in np.argwhere((high > low).all(2)):
        one, other = cv2.convexHull(a[i]), cv2.convexHull(b[j])
        common, _ = cv2.intersectConvexConvex(one, other)
        overlap[i, j] = common / max(sizes[0][i] + sizes[1][j] - common, 1e-6)
    return overlap
