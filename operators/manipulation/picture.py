"""The consumer's picture: context and ROI of one exposure in, one picture of the workplace out.

The network reads one picture of a fixed part of the field. The context is enlarged to it, and what
the ROI shows is put in its place at its own resolution.
"""

import math
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline import Frame

Region = tuple[float, float, float, float]  # xyxy, shares of the field

WORKPLACE: Region = (0.2, 0.36667, 0.8, 0.76667)  # where the grippers meet the objects
PICTURE_PX = (240, 120)  # width, height


def shown(
    frames: Iterable[Frame], workplace: Region = WORKPLACE, size_px: tuple[int, int] = PICTURE_PX
) -> NDArray[np.uint8]:
    """Return the picture (h, w, 3) RGB of frames of one exposure, later ones on top.

    Frames without pixels are left out; what no frame shows is black.
    """
    width, height = size_px
    out = np.zeros((height, width, 3), np.uint8)
    for frame in frames:
        if frame.pixels.size:
            grid = frame.header.geometry
            pixels = np.asarray(frame.pixels, np.uint8)
            place(pixels, frame.window, (grid.width_px, grid.height_px), out, workplace)
    return out


def covered(
    frame: Frame, workplace: Region = WORKPLACE, size_px: tuple[int, int] = PICTURE_PX
) -> NDArray[np.bool_]:
    """Return where (h, w) a frame lies in the picture."""
    grid, (width, height) = frame.header.geometry, size_px
    out = np.zeros((height, width, 3), np.uint8)
    if frame.pixels.size:
        white = np.full((1, 1, 3), 255, np.uint8)
        place(white, frame.window, (grid.width_px, grid.height_px), out, workplace)
    return out[..., 0] > 0


def place(
    pixels: NDArray[np.uint8],
    window: tuple[int, int, int, int],
    field_px: tuple[int, int],
    out: NDArray[np.uint8],
    workplace: Region = WORKPLACE,
) -> None:
    """Put `pixels` (h, w, 3), which show a window of the field, where they belong in `out`.

    Only pixels of `out` whose centre lies in the window change.
    """
    inside, scale, first = [], [], []
    for axis in range(2):
        side, pixels_side = out.shape[1 - axis], pixels.shape[1 - axis]
        origin = workplace[axis] * field_px[axis]
        step = (workplace[axis + 2] - workplace[axis]) * field_px[axis] / side  # sensor pixels
        low, high = (math.ceil((window[end] - origin) / step - 0.5) for end in (axis, axis + 2))
        inside.append((max(0, low), min(side, high)))
        per_px = pixels_side / (window[axis + 2] - window[axis])  # pixels of the frame
        scale.append(step * per_px)
        first.append((origin - window[axis]) * per_px)
    (left, right), (top, bottom) = inside
    if left >= right or top >= bottom:
        return
    if max(scale) > 1:
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
