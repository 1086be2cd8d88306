"""The consumer's picture: context and ROI of one exposure in, one picture of the workplace out.

The network reads one picture of a fixed part of the field. The context is enlarged to it, and what
the ROI shows is put in its place at its own resolution.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline import Frame

WORKPLACE = (0.2, 0.36667, 0.8, 0.76667)  # xyxy, shares of the field: where the hands meet objects
PICTURE_PX = (240, 120)  # width, height
MOST_SHRUNK = 1.0  # pixels of a frame per pixel of the picture above which areas are averaged


def composite(*frames: Frame) -> NDArray[np.uint8]:
    """Return the picture (120, 240, 3) RGB of frames of one exposure, later ones on top.

    Frames without pixels are left out; what no frame shows is black.
    """
    width, height = PICTURE_PX
    out = np.zeros((height, width, 3), np.uint8)
    for frame in frames:
        if frame.pixels.size:
            grid = frame.header.geometry
            place(frame.pixels, frame.window, (grid.width_px, grid.height_px), out)
    return out


def place(
    pixels: NDArray[np.uint8],
    window: tuple[int, int, int, int],
    field_px: tuple[int, int],
    out: NDArray[np.uint8],
) -> None:
    """Put `pixels` (h, w, 3), which show a window of the field, where they belong in `out`.

    Only pixels of `out` whose centre lies in the window change.
    """
    (height, width), (rows, columns) = pixels.shape[:2], out.shape[:2]
    lefts = [WORKPLACE[0] * field_px[0], WORKPLACE[1] * field_px[1]]
    per_px = [
        (WORKPLACE[2] - WORKPLACE[0]) * field_px[0] / columns,
        (WORKPLACE[3] - WORKPLACE[1]) * field_px[1] / rows,
    ]  # sensor pixels per pixel of the picture
    inside = [
        (
            max(0, math.ceil((window[axis] - lefts[axis]) / per_px[axis] - 0.5)),
            min(
                out.shape[1 - axis],
                math.ceil((window[axis + 2] - lefts[axis]) / per_px[axis] - 0.5),
            ),
        )
        for axis in range(2)
    ]
    (left, right), (top, bottom) = inside
    if left >= right or top >= bottom:
        return
    scale = [
        per_px[0] * width / (window[2] - window[0]),
        per_px[1] * height / (window[3] - window[1]),
    ]  # pixels of the frame per pixel of the picture
    first = [
        ((lefts[0] - window[0]) / (window[2] - window[0])) * width,
        ((lefts[1] - window[1]) / (window[3] - window[1])) * height,
    ]  # where the picture's corner is in the frame, pixels
    if max(scale) > MOST_SHRUNK:
        pixels, scale, first = _averaged(pixels, scale, first)
    turn = np.array(
        [
            [scale[0], 0, first[0] + scale[0] * (left + 0.5) - 0.5],
            [0, scale[1], first[1] + scale[1] * (top + 0.5) - 0.5],
        ]
    )
    out[top:bottom, left:right] = cv2.warpAffine(
        pixels,
        turn,
        (right - left, bottom - top),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )


def _averaged(
    pixels: NDArray[np.uint8], scale: list[float], first: list[float]
) -> tuple[NDArray[np.uint8], list[float], list[float]]:
    """Average areas first, so that every pixel of the frame counts in the picture."""
    height, width = pixels.shape[:2]
    sides = max(1, round(width / scale[0])), max(1, round(height / scale[1]))
    small = cv2.resize(pixels, sides, interpolation=cv2.INTER_AREA)
    kept = [sides[0] / width, sides[1] / height]
    return (
        np.asarray(small, np.uint8),
        [s * k for s, k in zip(scale, kept, strict=True)],
        [f * k for f, k in zip(first, kept, strict=True)],
    )
