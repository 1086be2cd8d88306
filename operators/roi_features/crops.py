"""Crop squares from a picture: boxes and a frame -> small pictures of one size."""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline import Frame

FILL = 114  # grey value outside the frame
# least side of a square, ROI pixels: a ball of 11 px is told from a boot by what is around it
LEAST_PX = 40.0


def to_squares(
    boxes: NDArray[np.float32], roi: Frame, margin: float, least_px: float = LEAST_PX
) -> NDArray[np.float32]:
    """Squares around boxes, with a margin: (n, 4) sensor pixels -> (n, 4) xyxy, ROI pixels."""
    left, top, right, bottom = roi.window
    scale = np.array(
        [roi.pixels.shape[1] / (right - left), roi.pixels.shape[0] / (bottom - top)], np.float32
    )
    low = (boxes[:, :2] - np.array([left, top], np.float32)) * scale
    high = (boxes[:, 2:] - np.array([left, top], np.float32)) * scale
    half = (high - low).max(1, keepdims=True) * np.float32((1 + margin) / 2)
    half = np.maximum(half, np.float32(least_px / 2))
    middle = (low + high) / 2
    return np.concatenate([middle - half, middle + half], 1)


def cut(
    picture: NDArray[np.uint8], squares: NDArray[np.float32], side_px: tuple[int, int]
) -> Iterator[NDArray[np.float32]]:
    """Squares (n, 4) of a picture (h, w, 3), scaled to (width, height); outside it is grey.

    Values are integers 0..255. A crop may reuse the memory of the previous one.
    """
    width_px, height_px = side_px
    canvas = np.empty((height_px, width_px, 3), np.float32)
    sides = np.maximum(squares[:, 2:3] - squares[:, :1], 1.0)
    limits = picture.shape[1::-1] * 2
    parts = np.clip(np.round(squares), 0, limits).astype(int)
    gains = np.array([width_px, height_px] * 2) / sides
    targets = np.round((parts - np.tile(squares[:, :2], 2)) * gains)
    targets = np.clip(targets, 0, [width_px, height_px] * 2).astype(int)
    for part, target, gain in zip(parts.tolist(), targets.tolist(), gains[:, 0], strict=True):
        left, top, right, bottom = part
        x0, y0, x1, y1 = target
        whole = target == [0, 0, width_px, height_px]
        if not whole:
            canvas[:] = FILL
        if x0 < x1 and y0 < y1 and left < right and top < bottom:
            scale = shrunk if gain < 1 else enlarged
            canvas[y0:y1, x0:x1] = scale(picture[top:bottom, left:right], (x1 - x0, y1 - y0))
        yield canvas


def shrunk(picture: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.generic]:
    """A picture (h, w, 3) at (width, height), averaged: shirt numbers must not break up."""
    if not picture.shape[1] % size_px[0] and not picture.shape[0] % size_px[1]:
        return cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA)
    # OpenCV averages floats in two thirds of the time; only whole blocks are rounded another way
    found = cv2.resize(picture.astype(np.float32), size_px, interpolation=cv2.INTER_AREA)
    return np.rint(found, out=found)


def enlarged(picture: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.generic]:
    """A picture (h, w, 3) at (width, height), interpolated."""
    return cv2.resize(picture, size_px, interpolation=cv2.INTER_LINEAR)
